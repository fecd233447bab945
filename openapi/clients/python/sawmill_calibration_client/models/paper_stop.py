from enum import StrEnum


class PaperStop(StrEnum):
    PUBLISHED = "published"
    TIGHT = "tight"

    def __str__(self) -> str:
        return str(self.value)
