from enum import StrEnum


class RowAlignment(StrEnum):
    FEATURES = "features"
    OFF = "off"
    PROFILE = "profile"

    def __str__(self) -> str:
        return str(self.value)
