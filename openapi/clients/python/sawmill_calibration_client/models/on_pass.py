from enum import StrEnum


class OnPass(StrEnum):
    ACTIVATE = "activate"
    REPORT = "report"

    def __str__(self) -> str:
        return str(self.value)
