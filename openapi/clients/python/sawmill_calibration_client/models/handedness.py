from enum import StrEnum


class Handedness(StrEnum):
    AS_DRAWN = "as-drawn"
    FROM_BEHIND = "from-behind"

    def __str__(self) -> str:
        return str(self.value)
