from enum import StrEnum


class ColorMap(StrEnum):
    GREY = "grey"
    INFERNO = "inferno"
    MAGMA = "magma"
    VIRIDIS = "viridis"

    def __str__(self) -> str:
        return str(self.value)
