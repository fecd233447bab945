from enum import StrEnum


class UploadState(StrEnum):
    COMPLETE = "complete"
    RECEIVING = "receiving"
    USED = "used"

    def __str__(self) -> str:
        return str(self.value)
