from enum import StrEnum


class Axis(StrEnum):
    X = "x"
    Y = "y"

    def __str__(self) -> str:
        return str(self.value)
