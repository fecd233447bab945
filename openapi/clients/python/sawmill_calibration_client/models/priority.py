from enum import StrEnum


class Priority(StrEnum):
    BACKGROUND = "background"
    BATCH = "batch"
    WAITED_FOR = "waited-for"

    def __str__(self) -> str:
        return str(self.value)
