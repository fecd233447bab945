from enum import StrEnum


class DisturbedPart(StrEnum):
    BEARING = "bearing"
    ENCODER = "encoder"

    def __str__(self) -> str:
        return str(self.value)
