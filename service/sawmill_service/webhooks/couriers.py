"""Delivery of due events and of test messages to webhooks, signed (https://www.standardwebhooks.com, 1.0.0).

At least once: an event counts as delivered when that is noted, so a process that is killed between sending and noting
sends again, with the same `webhook-id`. A receiver that fails gets longer and longer pauses; other receivers do not
wait.
"""

import asyncio
import hashlib
import hmac
from base64 import b64decode, b64encode
from collections.abc import Callable, Sequence
from datetime import datetime
from http import HTTPStatus
from uuid import uuid4

import structlog

from sawmill_platform.contracts.events import Event
from sawmill_platform.contracts.webhooks import EventMessage, TestedWebhook, WebhookTest, WebhookTestMessage
from sawmill_platform.errors import StorageError
from sawmill_platform.ledger.event_reader import EventReader
from sawmill_platform.webhooks.outbox import DeliveryAttempt, Outbox, Pending, message_id
from sawmill_platform.webhooks.webhook_store import PREFIX, WebhookStore
from sawmill_platform.workers.logs import going_on
from sawmill_service.webhooks.destinations import AllowedDestinations
from sawmill_service.webhooks.sending import DeliveryAnswer, WebhookSending
from sawmill_vocabulary.version import VERSION

# Waits before the second and later attempts, as the specification proposes: three days in all.
WAITS_S = (5.0, 300.0, 1800.0, 7200.0, 18000.0, 36000.0, 50400.0, 72000.0, 86400.0)
# Waits are longer by up to this share, so that receivers that failed together are not tried together.
JITTER = 0.1
LONGEST_RETRY_AFTER_S = 86400.0
_MOST_READS = 20  # reads of a few hundred events each, before anything is sent


class Couriers:
    """Tasks that send, one for each webhook with due events; used by one event loop."""

    def __init__(self, outbox: Outbox, sending: WebhookSending, jitter: Callable[[], float]) -> None:
        self._outbox = outbox
        self._sending = sending
        self._jitter = jitter
        self._reader: EventReader | None = None
        self._under_way: dict[str, asyncio.Task[None]] = {}

    async def send_due(self) -> None:
        """Begin to send what can be sent now, unless another process sends."""
        if not await asyncio.to_thread(self._outbox.is_wanted):
            return
        if not await asyncio.to_thread(self._outbox.hold):
            await self._end()
            return
        for webhook_id in await asyncio.to_thread(self._outbox.due, await asyncio.to_thread(self._read)):
            if webhook_id not in self._under_way:
                self._under_way[webhook_id] = asyncio.create_task(self._send_to(webhook_id))

    async def finish(self) -> None:
        """Wait until all started deliveries have ended."""
        await asyncio.gather(*self._under_way.values())

    async def stop(self) -> None:
        """Cancel the running deliveries, and let another process send at once."""
        await self._end()
        with going_on("webhooks-not-released"):
            await asyncio.to_thread(self._outbox.release)

    async def _end(self) -> None:
        tasks = list(self._under_way.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        self._under_way.clear()  # a task that never started has not removed itself

    def _read(self) -> int:
        """Read new events, and return the number up to which all events are written."""
        if self._reader is None:
            self._reader = self._outbox.reader()
        for _ in range(_MOST_READS):
            if not self._reader.read():
                break
        return self._reader.number

    async def _send_to(self, webhook_id: str) -> None:
        try:
            with going_on("webhook-put-off", webhook_id=webhook_id):
                await self._send_pending(webhook_id)
        finally:
            self._under_way.pop(webhook_id, None)

    async def _send_pending(self, webhook_id: str) -> None:
        try:
            while pending := await asyncio.to_thread(self._pending, webhook_id):
                if not await self._send(pending):
                    return
        except StorageError as error:
            structlog.get_logger().warning("webhook-put-off", webhook_id=webhook_id, reason=str(error))

    def _pending(self, webhook_id: str) -> Pending | None:
        assert self._reader is not None  # noqa: S101 - read before anything is sent
        return self._outbox.pending(webhook_id, self._reader.number)

    async def _send(self, pending: Pending) -> bool:
        """Send the pending events; return whether all were delivered, so that there may be more."""
        failures = pending.failures
        for event in pending.events:
            headers, body = await asyncio.to_thread(self._message, pending, event)
            answer = await self._sending.post(pending.url, headers, body)
            attempt = DeliveryAttempt(answer.status, answer.reason, self._wait_s(answer, failures))
            if attempt.reason is not None:
                structlog.get_logger().warning(
                    "webhook-failed",
                    webhook_id=pending.webhook_id,
                    number=event.number,
                    failures=failures + 1,
                    reason=attempt.reason,
                    wait_s=None if attempt.wait_s is None else round(attempt.wait_s),
                )
            if not await asyncio.to_thread(self._outbox.note, pending, event, attempt):
                return False
            failures = 0
        return True

    def _message(self, pending: Pending, event: Event) -> tuple[dict[str, str], bytes]:
        body = body_of_event(event)
        return headers_of(message_id(pending.webhook_id, event), self._outbox.now(), body, pending.secrets), body

    def _wait_s(self, answer: DeliveryAnswer, failures: int) -> float | None:
        """Return the wait before the next attempt, s; None: there is none."""
        if answer.reason is None or answer.status == HTTPStatus.GONE or failures >= len(WAITS_S):
            return None
        wait_s = WAITS_S[failures] * (1.0 + JITTER * self._jitter())
        return max(wait_s, min(answer.retry_after_s, LONGEST_RETRY_AFTER_S))


def body_of_event(event: Event) -> bytes:
    """Write the message about an event."""
    return EventMessage(type=event.type, timestamp=event.at, data=event).model_dump_json().encode()


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


def send_test(webhooks: WebhookStore, allowed: AllowedDestinations, webhook_id: str) -> WebhookTest:
    """Send a test message, and wait in this thread for the answer or the time limit; the caller notes the result."""
    # Imported here: the HTTP client is not needed where nothing may be sent.
    from sawmill_service.webhooks.sending import WebhookSending  # noqa: PLC0415

    webhook, secrets, now = webhooks.signing(webhook_id)
    message_id = f"msg_{uuid4().hex}"
    tested = TestedWebhook(webhook_id=webhook_id, description=webhook.description)
    body = WebhookTestMessage(timestamp=now, data=tested).model_dump_json().encode()
    answer = asyncio.run(WebhookSending(allowed).post(webhook.url, headers_of(message_id, now, body, secrets), body))
    return WebhookTest(
        delivered=answer.reason is None,
        message_id=message_id,
        webhook_id=webhook_id,
        status=answer.status,
        reason=answer.reason,
    )
