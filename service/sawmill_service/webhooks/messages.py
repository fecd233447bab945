"""An event as a signed message (Standard Webhooks 1.0.0, https://www.standardwebhooks.com)."""

import hashlib
import hmac
import json
from base64 import b64decode, b64encode
from collections.abc import Sequence
from datetime import datetime

from sawmill_worker.contracts.events import Event
from sawmill_worker.storage.webhooks import PREFIX
from sawmill_worker.vocabulary.version import VERSION


def body_of(what: str, at: datetime, data: object) -> bytes:
    """The JSON of a message: what happened, when, and all that is known about it."""
    text = json.dumps({"type": what, "timestamp": at.isoformat(), "data": data}, separators=(",", ":"))
    return text.encode()


def body_of_event(event: Event) -> bytes:
    """As `/v1/events` has the event."""
    return body_of(event.what, event.at, event.model_dump(mode="json"))


def headers_of(message_id: str, now: datetime, body: bytes, secrets: Sequence[str]) -> dict[str, str]:
    """The headers of an attempt: the id, its own time, and a signature with each secret."""
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
