from enum import StrEnum


class MetalHandling(StrEnum):
    AUTO = "auto"
    INTERPOLATE = "interpolate"
    NONE = "none"

    def __str__(self) -> str:
        return str(self.value)
