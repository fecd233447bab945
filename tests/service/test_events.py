"""The stream of what happens."""

import asyncio
import json
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest
from asgi import asynchronous, blocks, scope_of
from live_service import wait_until
from machine_faults import database_away

from sawmill_platform.contracts.events import Event
from sawmill_platform.contracts.keys import KeyRequest, Scope
from sawmill_platform.errors import StorageUnavailable
from sawmill_platform.ledger.event_reader import EventReader
from sawmill_platform.ledger.events import Events
from sawmill_service.app import create_app
from sawmill_service.event_feed import EventFeed, StreamTimes
from sawmill_service.settings import ServiceSettings
from sawmill_store.store import Store

HEARD_S = 0.2  # some twenty looks at the table, by the settings of these tests


class WatchedEvents(Events):
    """The table of events, with how often and how far it was read, and what is called before and after each look."""

    def __init__(self, store: Store) -> None:
        super().__init__(store.database)
        self.reads = self.through = 0
        self.before: Callable[[], object] = lambda: None
        self.after: Callable[[], object] = lambda: None

    def reader(self) -> EventReader:
        return WatchedReader(self, super().reader())


class WatchedReader:
    def __init__(self, events: WatchedEvents, reader: EventReader) -> None:
        self._events, self._reader = events, reader

    @property
    def number(self) -> int:
        return self._reader.number

    def read(self) -> list[Event]:
        self._events.before()
        found = self._reader.read()
        self._events.after()
        self._events.reads, self._events.through = self._events.reads + 1, self._reader.number
        return found


@pytest.fixture
def watched(seeded, store) -> WatchedEvents:
    events = WatchedEvents(store)
    seeded.app.state.event_feed = EventFeed(events, seeded.app.state.settings.event_poll_s)
    return events


@pytest.fixture
def follow(seeded, store, watched) -> Callable[..., list[dict[str, Any]]]:
    """Listens to a stream while something is done, and until the service stops."""
    stopping = seeded.app.state.stopping

    def act(do: Callable[[], None], ended: threading.Event) -> None:
        reads_before = watched.reads
        wait_until(lambda: watched.reads > reads_before)
        try:
            do()
            newest = store.events.newest_number()
            # A stream that ends with its key may do so before anybody has read of the key's end.
            wait_until(lambda: ended.is_set() or watched.through >= newest)
            ended.wait(HEARD_S)
        finally:
            stopping.begin()

    def listen(do: Callable[[], None] = lambda: None, query: str = "", **headers: str) -> list[dict[str, Any]]:
        stopping.begun, ended = False, threading.Event()
        acting = threading.Thread(target=act, args=[do, ended])
        acting.start()
        answer = seeded.get(f"/v1/events{query}", headers=headers, timeout=60)
        ended.set()
        acting.join()
        assert answer.headers["Content-Type"].startswith("text/event-stream")
        return blocks(answer.text)

    return listen


def happened(heard: list[dict[str, Any]]) -> list[str]:
    return [block["event"] for block in heard if block["event"] not in {"alive", "closing"}]


def test_a_stream_begins_with_now_and_tells_what_happens_until_the_service_stops(seeded, store, worker, follow):
    def calibrate() -> None:
        seeded.post("/v1/calibrations", json={"scan_id": "example"})
        worker.finish_calibration()

    first, *heard, last = follow(calibrate)
    assert (first["event"], first["retry"], happened(heard)) == ("alive", "1000", ["queued", "started", "succeeded"])
    assert [int(block["id"]) for block in heard] == [int(first["id"]) + step for step in (1, 2, 3)]
    seen = heard[-1]["data"]
    assert (seen["number"], seen["type"]) == (int(heard[-1]["id"]), "succeeded")
    assert (seen["scanner_id"], seen["subject"]) == ("example", "calibration")
    assert store.calibrations.get(seen["subject_id"]).state == "succeeded"
    assert (last["event"], last["id"], last["retry"]) == ("closing", heard[-1]["id"], "1000")


def test_a_stream_goes_on_where_its_client_has_been_and_one_of_a_scanner_leaves_the_others_out(follow, store, seeded):
    numbers = [block["id"] for block in follow(query="?after=0") if block["event"] not in {"alive", "closing"}]
    assert len(numbers) > 20
    assert numbers == sorted(set(numbers), key=int)
    seen, rest = numbers[9], numbers[10:]
    for heard in (follow(query=f"?after={seen}"), follow(query="?after=0", **{"Last-Event-ID": seen})):
        assert [block["id"] for block in heard if block["event"] not in {"alive", "closing"}] == rest
    delete = lambda: store.schedules.delete("example")  # noqa: E731
    assert happened(follow(delete, **{"Last-Event-ID": "999999"})) == ["schedule-deleted"]

    def change() -> None:
        for scanner_id in ("example", "example-spare"):
            scanner = seeded.get(f"/v1/scanners/{scanner_id}").json()
            spec = {name: scanner[name] for name in ("name", "constants")}
            assert seeded.put(f"/v1/scanners/{scanner_id}", json=spec).status_code == 200

    heard = follow(change, query="?scanner_id=example-spare")
    assert [block["data"]["scanner_id"] for block in heard[1:-1]] == ["example-spare"]
    # The service knows how far this client has heard, though the last event was not for it.
    assert int(heard[-1]["id"]) >= int(heard[-2]["id"])
    for wrong in ("-1", "x"):
        answer = seeded.get("/v1/events", headers={"Last-Event-ID": wrong})
        assert (answer.status_code, "Last-Event-ID" in answer.json()["detail"]) == (422, True)
        assert seeded.get(f"/v1/events?after={wrong}").status_code == 422


def test_silence_is_broken_and_an_outage_is_outlived(seeded, store, follow):
    seeded.app.state.stream_times = StreamTimes(alive_s=0.02)

    def go_away_and_come_back() -> None:
        with database_away(store.database) as met:
            assert met.wait(60.0)
            time.sleep(HEARD_S)
        store.schedules.delete("example")

    names = [block.get("event", "comment") for block in follow(go_away_and_come_back)]
    assert {"alive", "comment", "schedule-deleted"} <= set(names)
    assert names.index("comment") < len(names) - 1 - names[::-1].index("alive")


@pytest.mark.parametrize("patience_s", [0.0, 60.0], ids=["hangs", "has-failed"])
def test_no_stream_calls_a_database_alive_that_another_waits_for(store, patience_s):
    events = WatchedEvents(store)
    feed = EventFeed(events, 0.0, patience_s=patience_s)
    goes_on, slow = threading.Event(), threading.Event()

    def away() -> None:
        slow.set()
        goes_on.wait(60.0)
        raise StorageUnavailable("the database does not answer: away")

    async def after() -> str:
        try:
            await feed.after(0)
        except StorageUnavailable:
            return "away"
        return "alive"

    async def story() -> list[str]:
        heard = [await after()]
        events.before = away
        if patience_s:  # one look has failed; the next one has only begun
            goes_on.set()
            heard.append(await after())
            goes_on.clear()
            slow.clear()
        looking = asyncio.create_task(after())
        await asyncio.to_thread(slow.wait, 60.0)
        heard.append(await after())
        goes_on.set()
        heard.append(await looking)
        events.before = lambda: None
        return [*heard, await after()]

    first, *outage, last = asyncio.run(story())
    assert (first, set(outage), last) == ("alive", {"away"}, "alive")


class Held:
    """Holds who comes until the test lets it go on."""

    def __init__(self) -> None:
        self.begun, self.goes_on = threading.Event(), threading.Event()

    def __call__(self) -> None:
        self.begun.set()
        assert self.goes_on.wait(60.0)


@pytest.mark.usefixtures("seeded")
def test_a_stream_far_behind_misses_nothing_when_the_feed_starts_anew(store):
    slow = Held()

    class SlowForTheFirst(Events):
        """Hands older events over when the test lets it, to whom asks first."""

        def following(self, *given: Any, **named: Any) -> list[Event]:
            found = super().following(*given, **named)
            if not slow.begun.is_set():
                slow()
            return found

    feed = EventFeed(SlowForTheFirst(store.database), -1.0, forgotten_s=-1.0)

    async def story() -> list[int]:
        behind = asyncio.create_task(feed.after(0))
        await asyncio.to_thread(slow.begun.wait, 60.0)
        store.schedules.delete("example")
        await feed.after(store.events.newest_number())
        slow.goes_on.set()
        number, heard = await behind
        return [event.number for event in [*heard, *(await feed.after(number))[1]]]

    assert asyncio.run(story()) == [event.number for event in store.events.following(0)]


@pytest.mark.usefixtures("seeded")
def test_a_stream_misses_nothing_of_what_another_s_look_has_not_handed_over(store):
    events, slow = WatchedEvents(store), Held()
    feed = EventFeed(events, -1.0)
    begins_at = store.events.newest_number()

    async def story() -> list[int]:
        await feed.after(begins_at)
        store.schedules.delete("example")
        events.after = slow
        looking = asyncio.create_task(feed.after(begins_at))
        await asyncio.to_thread(slow.begun.wait, 60.0)
        events.after = lambda: None
        number, heard = await feed.after(begins_at)
        slow.goes_on.set()
        await looking
        return [event.number for event in [*heard, *(await feed.after(number))[1]]]

    assert asyncio.run(story()) == [event.number for event in store.events.following(begins_at)] != []


@pytest.mark.parametrize("settings", [ServiceSettings(token="t" * 32, event_poll_s=0.01)], ids=["with-a-token"])
def test_a_stream_ends_with_its_key(seeded, store, follow):
    seeded.app.state.stream_times = StreamTimes(access_s=0.02)
    key = store.keys.create(KeyRequest(name="tablet", scope=Scope.READ))
    bearer = {"Authorization": f"Bearer {key.secret}"}
    assert follow(lambda: store.keys.revoke(key.id), **bearer)[-1]["event"] == "closing"
    assert seeded.get("/v1/events", headers=bearer).status_code == 401


def test_many_streams_look_at_the_table_as_one_would_and_the_slow_ones_miss_nothing(store):
    app = create_app(ServiceSettings(event_poll_s=0.05), store, lambda _: None)
    events = WatchedEvents(store)
    app.state.event_feed = EventFeed(events, 0.05, kept=3)

    async def listen() -> list[str]:
        async with asynchronous(app) as client:
            async with asyncio.TaskGroup() as group:
                tasks = [group.create_task(client.get("/v1/events?after=0")) for _ in range(20)]
                await asyncio.sleep(1.0)
                app.state.stopping.begin()
            return [task.result().text for task in tasks]

    begun_at_s = time.monotonic()
    texts = asyncio.run(listen())
    assert events.reads <= (time.monotonic() - begun_at_s) / 0.05 + 5, "more often than one alone would look"
    every = [str(event.number) for event in store.events.following(0)]
    for text in texts:
        assert [block["id"] for block in blocks(text) if block["event"] not in {"alive", "closing"}] == every


def test_a_client_that_leaves_while_events_wait_for_it_is_no_failure(seeded, watched, log_lines):
    """It has not read the first event when it leaves, and others wait behind that."""

    async def story() -> None:
        sending = asyncio.Event()

        async def receive() -> dict[str, Any]:
            if not sending.is_set():
                await sending.wait()
                await asyncio.to_thread(wait_until, lambda: watched.reads > 0)
                await asyncio.sleep(0.2)  # several events have come up, and wait
            return {"type": "http.disconnect"}

        async def send(message: dict[str, Any]) -> None:
            if message["type"] == "http.response.body":
                sending.set()
                await asyncio.Event().wait()

        await asyncio.wait_for(seeded.app(scope_of("/v1/events?after=0"), receive, send), 60)

    asyncio.run(story())
    assert [(line["event"], line["level"]) for line in log_lines()] == [("request", "info")]


def test_the_feed_tells_a_key_to_read_what_happened_and_not_who_did_it(seeded, store):
    reader, chief = (store.keys.create(KeyRequest(name=name, scope=Scope(name))) for name in ("read", "admin"))
    seeded.app = create_app(ServiceSettings(public_url="https://calibration.mill.example"), store, print)
    seeded.headers = {"Authorization": f"Bearer {chief.secret}"}
    seeded.delete("/v1/schedules/example")
    (decided,) = store.audit.page(limit=1).items
    assert (decided.action, decided.who, decided.key_id) == ("schedule-deleted", "admin", chief.id)
    assert decided.address
    assert decided.request_id
    seeded.headers = {"Authorization": f"Bearer {reader.secret}"}
    assert seeded.get("/v1/audit").status_code == 403
    job = seeded.get("/v1/calibrations/example").json()["job_id"]
    published = seeded.get(f"/v1/jobs/{job}/history").json()["events"]
    published += [event.model_dump(mode="json") for event in store.events.following(0)]
    assert "schedule-deleted" in {event["type"] for event in published}
    assert {name for event in published for name in event} == {
        *("number", "at", "type", "scanner_id", "subject", "subject_id", "job_id", "attempt", "worker", "detail")
    }
    secrets = {decided.request_id, decided.address}
    assert not [event for event in published for each in secrets if each in json.dumps(event)]
