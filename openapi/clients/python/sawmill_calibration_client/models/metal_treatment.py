from enum import StrEnum


class MetalTreatment(StrEnum):
    INTERPOLATED = "interpolated"
    LEFT_OUT = "left-out"

    def __str__(self) -> str:
        return str(self.value)
