from enum import StrEnum


class RingRemoval(StrEnum):
    OFF = "off"
    SORTING = "sorting"

    def __str__(self) -> str:
        return str(self.value)
