from enum import StrEnum


class PhantomState(StrEnum):
    READY = "ready"
    REFUSED = "refused"
    TRACING = "tracing"

    def __str__(self) -> str:
        return str(self.value)
