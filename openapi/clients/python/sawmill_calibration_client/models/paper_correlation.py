from enum import StrEnum


class PaperCorrelation(StrEnum):
    NORMALISED = "normalised"
    UNNORMALISED = "unnormalised"

    def __str__(self) -> str:
        return str(self.value)
