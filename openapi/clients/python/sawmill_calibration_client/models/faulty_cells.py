from enum import StrEnum


class FaultyCells(StrEnum):
    AUTO = "auto"
    BRIDGE = "bridge"
    KEEP = "keep"

    def __str__(self) -> str:
        return str(self.value)
