from enum import StrEnum


class MovedBody(StrEnum):
    BOTH = "both"
    LOG = "log"
    PHANTOM = "phantom"

    def __str__(self) -> str:
        return str(self.value)
