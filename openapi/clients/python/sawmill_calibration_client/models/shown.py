from enum import StrEnum


class Shown(StrEnum):
    ATTENUATION = "attenuation"
    DEVIATION = "deviation"

    def __str__(self) -> str:
        return str(self.value)
