"""A year of events sent to two webhooks: one for everything, whose receiver is away for a week, and one for alarms.

Run: python benchmarks/webhook_year.py [--events 20000]. On SQLite, in a temporary folder, with a clock that is given;
the messages are sent to a receiver on loopback. Exit code 1 unless each arrived once and in order.
"""

import argparse
import asyncio
import resource
import socket
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

import h11
from sqlalchemy import func, insert, select

from sawmill_contracts import mill_events
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.webhooks import WebhookAsk
from sawmill_platform.database.tables import DeliveryRow, EventRow
from sawmill_platform.settings import StorageSettings
from sawmill_platform.webhooks.outbox import LEASE, message_id
from sawmill_service.webhooks.couriers import Couriers
from sawmill_service.webhooks.destinations import AllowedDestinations
from sawmill_service.webhooks.sending import WebhookSending
from sawmill_store.store import Store

DAYS = 365
AWAY = range(180, 187)
ALARMS_EACH = 50  # events to an alarm
LOOKS_A_DAY = 4


class GivenClock:
    """Moves when it is moved."""

    def __init__(self) -> None:
        self.now = datetime(2026, 1, 1, tzinfo=UTC)

    def __call__(self) -> datetime:
        """Return the current time."""
        return self.now


class Receiver:
    """Answers 204, or 503 while it is away, and keeps the ids that came, by path."""

    def __init__(self) -> None:
        self.away = False
        self.arrived: dict[str, list[str]] = {"/all": [], "/alarms": []}
        self.refused = 0

    async def answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer one request a connection."""
        connection, path, identifier = h11.Connection(h11.SERVER), "", ""
        while (event := connection.next_event()) is not h11.PAUSED:
            if event is h11.NEED_DATA:
                connection.receive_data(await reader.read(65536))
            elif isinstance(event, h11.Request):
                path = event.target.decode()
                identifier = dict(event.headers)[b"webhook-id"].decode()
            elif isinstance(event, h11.EndOfMessage):
                break
        away = self.away and path == "/all"
        if away:
            self.refused += 1
        else:
            self.arrived[path].append(identifier)
        status = b"503 Service Unavailable" if away else b"204 No Content"
        writer.write(b"HTTP/1.1 " + status + b"\r\nConnection: close\r\n\r\n")
        await writer.drain()
        writer.close()


@contextmanager
def listening(receiver: Receiver) -> Iterator[int]:
    """Start the receiver in a thread with a separate loop; yield its port."""
    with socket.create_server(("127.0.0.1", 0), backlog=100) as server:
        loop = asyncio.new_event_loop()

        async def serve() -> None:
            await asyncio.start_server(receiver.answer, sock=server)
            await asyncio.Event().wait()

        threading.Thread(target=lambda: loop.run_until_complete(serve()), daemon=True).start()
        yield server.getsockname()[1]


def main() -> None:
    """Simulate a year and print its costs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--events", type=int, default=20_000, help="in the year")
    options = parser.parse_args()
    receiver = Receiver()
    with tempfile.TemporaryDirectory() as folder, listening(receiver) as port:
        clock = GivenClock()
        store = Store.open(StorageSettings(data_folder=Path(folder), database_url=None), clock=clock)
        store.webhooks.create(WebhookAsk(url=f"http://127.0.0.1:{port}/all", events=["*"]))
        store.webhooks.create(WebhookAsk(url=f"http://127.0.0.1:{port}/alarms", events=["alarm-*"]))
        begun = time.perf_counter()
        most_rows, most_waiting, attempts_away = asyncio.run(year(store, clock, receiver, options.events))
        seconds = time.perf_counter() - begun
        right = all_arrived(store, receiver)
        database = sum(path.stat().st_size for path in Path(folder).glob("sawmill.db*"))
        sent = sum(len(ids) for ids in receiver.arrived.values())
        print(f"{options.events} events, {sent} messages in {seconds:.0f} s, {sent / seconds:.0f} a second")
        print(f"each once and in order: {'yes' if right else 'NO'}")
        print(f"receiver away for {len(AWAY)} days: {attempts_away} attempts, {most_waiting} events waited at most")
        print(f"rows of deliveries at most {most_rows}, database {database / 1e6:.0f} MB")
        print(f"peak of resident memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")
        store.close()
    raise SystemExit(0 if right else 1)


async def year(store: Store, clock: GivenClock, receiver: Receiver, events: int) -> tuple[int, int, int]:
    """Send a year's events; return the most delivery rows, the most events waiting, and the failed attempts."""
    couriers = Couriers(store.outbox(), WebhookSending(AllowedDestinations(["127.0.0.1"])), lambda: 0.5)
    most_rows = most_waiting = 0
    for day in range(DAYS):
        receiver.away = day in AWAY
        for look in range(LOOKS_A_DAY):
            piece = day * LOOKS_A_DAY + look
            happen(store, events * (piece + 1) // (DAYS * LOOKS_A_DAY) - events * piece // (DAYS * LOOKS_A_DAY))
            await couriers.send_due()
            await couriers.finish()
            clock.now += timedelta(days=1) / LOOKS_A_DAY
        store.webhooks.forget_deliveries()
        if day == AWAY.stop - 1:
            # Deliveries were given up, since it was down for three days; the administrator turns it on again.
            assert [webhook.state for webhook in store.webhooks.all().webhooks].count("paused") == 1
            most_waiting = max(webhook.waiting for webhook in store.webhooks.all().webhooks)
            for webhook in store.webhooks.all().webhooks:
                store.webhooks.enable(webhook.id, enabled=True)
        most_rows = max(most_rows, delivery_rows(store))
    clock.now += LEASE
    await couriers.send_due()
    await couriers.finish()
    await couriers.stop()
    return most_rows, most_waiting, receiver.refused


def happen(store: Store, number: int) -> None:
    """Store events in one transaction; every fiftieth is an alarm."""
    first, now = store.events.newest_number(), store.now()
    kinds = [event_kinds.SUCCEEDED] * (ALARMS_EACH - 1) + [mill_events.ALARM_OPENED]
    rows = [
        {"at": now, "what": kinds[(first + k) % ALARMS_EACH], "subject": "scan", "subject_id": f"scan-{first + k}"}
        for k in range(number)
    ]
    if rows:
        with store.database.write() as session:
            session.execute(insert(EventRow), rows)


def delivery_rows(store: Store) -> int:
    """Count the rows of the table of deliveries."""
    with store.database.read() as session:
        return session.scalar(select(func.count()).select_from(DeliveryRow)) or 0


def all_arrived(store: Store, receiver: Receiver) -> bool:
    """Return whether every event has arrived once, in order, by comparison with the ids of the stored events."""
    for webhook in store.webhooks.all().webhooks:
        path = webhook.url.rpartition("/")[2]
        wanted, number = [], 0
        while events := store.events.following(number):
            number = events[-1].number
            wanted += [
                message_id(webhook.id, event)
                for event in events
                if (path == "all" and event.number > 1) or event.what is mill_events.ALARM_OPENED
            ]
        if receiver.arrived[f"/{path}"] != wanted:
            return False
    return True


if __name__ == "__main__":
    main()
