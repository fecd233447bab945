"""An event as a signed message (Standard Webhooks 1.0.0, https://www.standardwebhooks.com)."""

import hashlib
import hmac
from base64 import b64decode, b64encode
from collections.abc import Sequence
from datetime import datetime

from sawmill_platform.contracts.events import Event
from sawmill_platform.contracts.webhooks import EventMessage
from sawmill_platform.webhooks.webhook_store import PREFIX
from sawmill_vocabulary.version import VERSION


def body_of_event(event: Event) -> bytes:
    """Write the message about an event."""
    return EventMessage(type=event.what, timestamp=event.at, data=event).model_dump_json().encode()


def headers_of(message_id: str, now: datetime, body: bytes, secrets: Sequence[str]) -> dict[str, str]:
    """Return the headers of an attempt: the id, the time of the attempt, and a signature with each secret."""
    seconds = str(int(now.timestamp()))
    return {
        "Content-Type": "application/json",
        "User-Agent": f"sawmill-calibration/{VERSION}",
        "webhook-id": message_id,
        "webhook-timestamp": seconds,
        "webhook-signature": " ".join(_signed(secret, message_id, seconds, body) for secret in secrets),
    }


def _signed(secret: str, message_id: str, seconds: str, body: bytes) -> str:
    key = b64decode(secret.removeprefix(PREFIX))
    content = f"{message_id}.{seconds}.".encode() + body
    return f"v1,{b64encode(hmac.new(key, content, hashlib.sha256).digest()).decode()}"
