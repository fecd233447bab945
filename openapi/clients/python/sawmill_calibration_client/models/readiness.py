from enum import StrEnum


class Readiness(StrEnum):
    DISK_FULL = "disk-full"
    READY = "ready"
    WITHOUT_WORKER = "without-worker"

    def __str__(self) -> str:
        return str(self.value)
