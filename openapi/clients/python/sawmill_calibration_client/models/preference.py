from enum import StrEnum


class Preference(StrEnum):
    QUALITY = "quality"
    SPEED = "speed"

    def __str__(self) -> str:
        return str(self.value)
