from enum import StrEnum


class Rotation(StrEnum):
    AS_GIVEN = "as-given"
    REVERSED = "reversed"

    def __str__(self) -> str:
        return str(self.value)
