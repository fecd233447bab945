from enum import StrEnum


class DataKind(StrEnum):
    COUNTS = "counts"
    LINE_INTEGRALS = "line-integrals"

    def __str__(self) -> str:
        return str(self.value)
