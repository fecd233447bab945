from enum import StrEnum


class PaperObjective(StrEnum):
    IMAGE = "image"
    PROJECTION = "projection"

    def __str__(self) -> str:
        return str(self.value)
