from enum import StrEnum


class FileVerdict(StrEnum):
    INCOMPLETE = "incomplete"
    READY = "ready"
    REFUSED = "refused"

    def __str__(self) -> str:
        return str(self.value)
