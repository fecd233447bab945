from enum import StrEnum


class DriftMethod(StrEnum):
    OPPOSITE_RAYS = "opposite-rays"
    VIEW_PAIRS = "view-pairs"

    def __str__(self) -> str:
        return str(self.value)
