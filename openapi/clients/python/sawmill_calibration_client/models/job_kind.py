from enum import StrEnum


class JobKind(StrEnum):
    CALIBRATE = "calibrate"
    DRIFT = "drift"
    INGEST = "ingest"
    INSPECT = "inspect"
    PLAN = "plan"
    RECONSTRUCT = "reconstruct"
    TRACE_PHANTOM = "trace-phantom"

    def __str__(self) -> str:
        return str(self.value)
