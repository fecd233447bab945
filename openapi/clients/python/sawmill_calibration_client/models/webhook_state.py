from enum import StrEnum


class WebhookState(StrEnum):
    ACTIVE = "active"
    DISABLED = "disabled"
    PAUSED = "paused"
    RETRYING = "retrying"

    def __str__(self) -> str:
        return str(self.value)
