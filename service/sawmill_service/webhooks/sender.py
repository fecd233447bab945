"""Thread that sends to webhooks, in every service process; one process at a time holds the right to send."""

import asyncio
import random
import threading
from types import TracebackType
from typing import TYPE_CHECKING, Self

import structlog

from sawmill_platform.errors import StorageError
from sawmill_platform.webhooks.outbox import Outbox
from sawmill_platform.workers.logs import going_on
from sawmill_service.webhooks.destinations import AllowedDestinations

if TYPE_CHECKING:
    from sawmill_service.webhooks.couriers import Couriers

POLL_S = 1.0


class WebhookSender:
    """Thread that sends, as a context manager; where no destination is allowed, no thread is started."""

    def __init__(self, outbox: Outbox, allowed: AllowedDestinations, *, poll_s: float = POLL_S) -> None:
        self._outbox = outbox
        self._allowed = allowed
        self._poll_s = poll_s
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="webhooks", daemon=True)

    def __enter__(self) -> Self:
        if self._allowed:
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        # Imported here: the HTTP client is not needed where nothing may be sent.
        from sawmill_service.webhooks.couriers import Couriers  # noqa: PLC0415
        from sawmill_service.webhooks.sending import WebhookSending  # noqa: PLC0415

        # The jitter needs no random numbers that are hard to guess.
        asyncio.run(self._send_until_stopped(Couriers(self._outbox, WebhookSending(self._allowed), random.random)))

    async def _send_until_stopped(self, couriers: "Couriers") -> None:
        answers = True
        while not self._stop.is_set():
            with going_on("webhooks-put-off"):
                try:
                    await couriers.send_due()
                    answers = True
                except StorageError as error:
                    if answers:  # one line for an outage
                        structlog.get_logger().warning("webhooks-put-off", reason=str(error))
                    answers = False
            await asyncio.to_thread(self._stop.wait, self._poll_s)
        await couriers.stop()
