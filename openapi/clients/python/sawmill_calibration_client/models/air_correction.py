from enum import StrEnum


class AirCorrection(StrEnum):
    AUTO = "auto"
    BACKGROUND = "background"
    OFF = "off"
    VIEWS = "views"

    def __str__(self) -> str:
        return str(self.value)
