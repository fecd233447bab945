from enum import StrEnum


class Agreement(StrEnum):
    AGREE = "agree"
    DISAGREE = "disagree"
    STRAINED = "strained"

    def __str__(self) -> str:
        return str(self.value)
