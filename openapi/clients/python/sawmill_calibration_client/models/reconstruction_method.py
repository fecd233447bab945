from enum import StrEnum


class ReconstructionMethod(StrEnum):
    AUTO = "auto"
    CAUCHY_MAP = "cauchy_map"
    FBP = "fbp"
    TIKHONOV = "tikhonov"
    TOTAL_VARIATION = "total_variation"

    def __str__(self) -> str:
        return str(self.value)
