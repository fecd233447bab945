from enum import StrEnum


class ScanState(StrEnum):
    INGESTING = "ingesting"
    READY = "ready"
    REFUSED = "refused"

    def __str__(self) -> str:
        return str(self.value)
