from enum import StrEnum


class CalibrationStatus(StrEnum):
    AMBIGUOUS_HANDEDNESS = "ambiguous-handedness"
    AMBIGUOUS_TURN = "ambiguous-turn"
    CALIBRATED = "calibrated"
    IMPRECISE = "imprecise"
    INCONSISTENT_SCALE = "inconsistent-scale"
    NOT_CONVERGED = "not-converged"
    WITHOUT_ERROR_BARS = "without-error-bars"

    def __str__(self) -> str:
        return str(self.value)
