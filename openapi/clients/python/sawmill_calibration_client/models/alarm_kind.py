from enum import StrEnum


class AlarmKind(StrEnum):
    DRIFT = "drift"
    NO_PHANTOM_SCAN = "no-phantom-scan"
    PHANTOM_EXPIRED = "phantom-expired"
    SCANNER_QUIET = "scanner-quiet"

    def __str__(self) -> str:
        return str(self.value)
