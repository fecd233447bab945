from enum import StrEnum


class AlphaRule(StrEnum):
    CROSS_VALIDATION = "cross-validation"
    DISCREPANCY = "discrepancy"
    GCV = "gcv"
    L_CURVE = "l-curve"

    def __str__(self) -> str:
        return str(self.value)
