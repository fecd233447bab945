"""How many requests somebody may send, and how many at once: without a network, and without waiting."""

import asyncio
from collections.abc import Callable
from typing import Any

import httpx
import pytest
from asgi import asynchronous, refusal
from pydantic import SecretStr, ValidationError
from results import SCANNER_SPEC as SPEC

from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.contracts.keys import KeyAsk, NewKey, Scope
from sawmill_service.app import create_app
from sawmill_service.event_feed import EventFeed
from sawmill_service.http.limits.rates import BoundedMemory, FailedLogins
from sawmill_service.http.problems import Refused
from sawmill_service.http.responses.waiting import JobEnds
from sawmill_service.settings import ServiceSettings
from sawmill_vocabulary import DataKind


@pytest.fixture
def limited(client, store) -> Callable[..., Any]:
    def limit(**bounds: Any) -> Any:
        client.app = create_app(ServiceSettings(**bounds), store, print)
        return client

    return limit


@pytest.fixture
def job_id(store) -> str:
    """The job that reads a scan."""
    scanner = store.scanners.create(ScannerSpec.model_validate(SPEC))
    spec = ScanSpec(scanner_id=scanner.id, data=DataKind.COUNTS)
    return store.scans.accept(spec, store.files.receive([b"scan"], max_bytes=9)).job_id


@pytest.fixture
def clock(moved_clock) -> Callable[[float], None]:
    """The library's windows are aligned to multiples of their length: tests begin 1 s after one, and move on."""
    moved_clock(stands_at_s=(now_s := 1_800_000_001.0))

    def pass_s(seconds: float) -> None:
        nonlocal now_s
        moved_clock(stands_at_s=(now_s := now_s + seconds))

    return pass_s


def test_requests_beyond_the_rate_are_refused_until_there_is_room_again(limited, clock):
    client = limited(rate_limit="3/minute")
    assert [client.get("/v1/scanners").status_code for _ in range(4)] == [200, 200, 200, 429]
    refused = client.get("/v1/scanners")
    assert refused.json()["code"] == "too-many-requests"
    assert refused.json()["detail"] == "127.0.0.1 may send 3 requests in 60 s, and has: try again in 59 s"
    assert refused.headers["Retry-After"] == "59"
    clock(59.0 + 30.0)  # half a window later half of what was sent before has run out
    assert client.get("/v1/scanners").status_code == 200


def test_changes_and_looks_at_health_have_a_rate_of_their_own(limited):
    client = limited(change_rate_limit="1/hour")
    assert client.post("/v1/scanners", json=SPEC).status_code == 201
    assert (client.post("/v1/scanners", json=SPEC).status_code, client.get("/v1/scanners").status_code) == (429, 200)
    client = limited(rate_limit="1/hour")
    assert [client.get("/v1/scanners").status_code for _ in range(2)] == [200, 429]
    assert client.get("/health/live").status_code == 200


@pytest.mark.parametrize("text", ["many", "0/minute", "5", "5/fortnight", ""])
def test_a_wrong_rate_is_refused_at_the_start(text):
    with pytest.raises(ValidationError, match="must be as in 1200/minute"):
        ServiceSettings(rate_limit=text)


def test_wrong_keys_of_an_address_are_counted_and_of_no_other(clock):
    logins = FailedLogins("2/minute")
    for secret in ("a", "b"):
        logins.failed("2001:db8::2", secret)
    with pytest.raises(Refused, match="wrong keys"):
        logins.failed("2001:db8::beef", "c")
    logins.failed("2001:db8:0:1::2", "c")
    clock(120.0)
    logins.failed("2001:db8::2", "d")


def test_a_million_addresses_leave_bounded_counts(clock):
    memory = BoundedMemory(most_counts=100)
    for number in range(1000):
        memory.incr(f"requests/{number}", 120)
        clock(0.01)
    assert len(memory.storage) <= 100
    assert memory.get("requests/999") == 1
    clock(130.0)
    memory.incr("another", 120)
    assert len(memory.storage) <= 100
    assert len(memory.expirations) == len(memory.storage)
    assert not memory.locks


def all_at_once(app: Any, *requests: tuple[str, str], body: bytes | None = None) -> list[httpx.Response]:
    """Answers of requests that are all open before the first is answered."""
    received, settled = asyncio.Event(), asyncio.Queue[object]()

    async def slow_body():
        settled.put_nowait(body)
        await received.wait()
        yield body

    async def send() -> list[httpx.Response]:
        async with asynchronous(app) as client:
            open_ = [
                asyncio.ensure_future(client.request(method, path, content=slow_body())) for method, path in requests
            ]
            async with asyncio.timeout(120):
                for task in open_:  # each is answered, or waits for its body
                    task.add_done_callback(settled.put_nowait)
                for _ in open_:
                    await settled.get()
            received.set()
            return await asyncio.gather(*open_)

    return asyncio.run(send())


def test_one_caller_has_a_bounded_number_of_requests_at_once(limited):
    client = limited(max_bodies_at_once=2)
    answers = all_at_once(client.app, *[("POST", "/v1/scanners")] * 3, body=b"{}")
    assert sorted(answer.status_code for answer in answers) == [422, 422, 429]
    refused = next(answer for answer in answers if answer.status_code == 429)
    assert refused.json()["detail"] == "2 uploads of 127.0.0.1 are being answered: wait for one of them"
    assert refused.headers["Retry-After"] == "2"
    # The places are free again.
    assert all_at_once(client.app, ("POST", "/v1/scanners"), body=b"{}")[0].status_code == 422


@pytest.mark.parametrize(
    ("path", "headers", "code"),
    [
        ("/v1/scanners", {f"a-{number}": "b" for number in range(101)}, "too-many-headers"),
        (f"/v1/{'a' * 21_000}", {}, "head-too-large"),
        (f"/v1/scanners?cursor={'a' * 21_000}", {}, "head-too-large"),
        ("/v1/scanners", {f"name-{number}": "b" * 300 for number in range(70)}, "head-too-large"),
    ],
    ids=["many headers", "path", "query", "headers"],
)
def test_a_head_that_is_too_large_is_refused_though_it_came_at_once(client, path, headers, code):
    assert refusal(client.get(path, headers=headers)) == (431, code)


def test_whoever_is_not_let_in_is_bounded_too(limited):
    client = limited(rate_limit="3/minute", token=SecretStr("t" * 40))
    assert [client.get("/v1/scanners").status_code for _ in range(5)] == [401, 401, 401, 429, 429]


def test_who_does_not_wait_takes_no_place_of_those_who_do(limited, store, job_id):
    client = limited(max_waits_at_once=1, event_poll_s=0.01)
    path, begun = f"/v1/jobs/{job_id}", asyncio.Event()

    class Followed(EventFeed):
        """Tells when somebody waits for its events."""

        async def start(self, after: int | None) -> int:
            begun.set()
            return await super().start(after)

    state = client.app.state
    state.job_ends = JobEnds(Followed(store.events, 0.01), state.stopping, 0.01)

    async def story() -> list[tuple[str, int]]:
        async with asynchronous(client.app) as http:
            waiting = asyncio.create_task(http.get(f"{path}?wait=50"))
            await asyncio.wait_for(begun.wait(), 60)
            queries = ("", "?wait=0", "?wait=0.0", "?wait=-0", "?wait=0e9", "?wait=5", "?wait=x", "?wait=0&wait=5")
            seen = [(query, (await http.get(path + query)).status_code) for query in queries]
            store.jobs.request_cancel(job_id)
            assert (await waiting).json()["state"] == "cancelled"
        return seen

    assert asyncio.run(story()) == [
        *((query, 200) for query in ("", "?wait=0", "?wait=0.0", "?wait=-0", "?wait=0e9")),
        ("?wait=5", 429),
        ("?wait=x", 422),
        ("?wait=0&wait=5", 429),
    ]


@pytest.mark.parametrize(
    ("bounds", "path"), [({"max_streams": 3}, "/events"), ({"max_waits_at_once": 100}, "?wait=50")]
)
def test_streams_and_waits_are_bounded_all_are_told_the_end_and_leave_their_places(
    limited, store, job_id, bounds, path
):
    client = limited(**bounds, event_poll_s=0.01)
    (most,) = bounds.values()

    async def story() -> None:
        async with asynchronous(client.app) as http:
            address = f"/v1/jobs/{job_id}{path}"
            requests = [asyncio.create_task(http.get(address)) for _ in range(most + 1)]
            refused, waiting = await asyncio.wait(requests, timeout=60, return_when=asyncio.FIRST_COMPLETED)
            assert [task.result().json()["code"] for task in refused] == ["too-many-requests"]
            assert (await http.get(f"/v1/jobs/{job_id}")).json()["state"] == "queued"
            store.jobs.request_cancel(job_id)
            answers = await asyncio.gather(*waiting)
            assert ["cancelled" in answer.text for answer in answers] == [True] * most
            again = await asyncio.gather(*[http.get(address) for _ in range(most)])
            assert {answer.status_code for answer in again} == {200}

    asyncio.run(story())


def test_a_display_finds_a_stream_when_other_keys_have_taken_theirs(limited, store):
    client = limited(max_streams=4, event_poll_s=0.01)
    keys = [store.keys.create(KeyAsk(name=name, scope=Scope.READ)) for name in ("first", "second")]
    display = store.keys.create(KeyAsk(name="wall", scope=Scope.READ, display=True))

    async def story() -> None:
        async with asynchronous(client.app) as http:

            def follow(key: NewKey) -> asyncio.Task[httpx.Response]:
                headers = {"Authorization": f"Bearer {key.secret}"}
                return asyncio.create_task(http.get("/v1/events", headers=headers))

            streams = [follow(key) for key in (*keys, *keys)]
            refused, open_streams = await asyncio.wait(streams, timeout=60, return_when=asyncio.FIRST_COMPLETED)
            assert ["3 streams of events are open" in task.result().text for task in refused] == [True]
            displays = [follow(display) for _ in range(2)]
            refused, on_the_wall = await asyncio.wait(displays, timeout=60, return_when=asyncio.FIRST_COMPLETED)
            assert ["4 streams of events are open" in task.result().text for task in refused] == [True]
            client.app.state.stopping.begin()
            ended = await asyncio.gather(*open_streams, *on_the_wall)
            assert {answer.status_code for answer in ended} == {200}

    asyncio.run(story())
