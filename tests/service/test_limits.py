"""Whose names and pages are answered, how many requests somebody may send, and a full queue."""

import asyncio
import json
from collections import Counter
from collections.abc import Callable
from inspect import iscoroutinefunction
from pathlib import Path
from typing import Any

import httpx
import pytest
from asgi import absent, asynchronous, refusal, text_of
from documented import check_documented, committed, with_file
from pydantic import SecretStr, ValidationError
from results import SCANNER_SPEC as SPEC

from sawmill_contracts.plans import PlanRequest
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.contracts.keys import KeyRequest, NewKey, Scope
from sawmill_service import dependencies
from sawmill_service.access import check_scope
from sawmill_service.app import create_app
from sawmill_service.event_feed import EventFeed
from sawmill_service.http.bodies.forms import check_csrf
from sawmill_service.http.bodies.sent_json import check_body, check_query
from sawmill_service.http.limits.rates import BoundedMemory, FailedLogins
from sawmill_service.http.problems import Refused
from sawmill_service.http.responses.waiting import JobEnds
from sawmill_service.http.route_rules import check_method
from sawmill_service.settings import ServiceSettings
from sawmill_store.store import Store
from sawmill_vocabulary import DataKind

HERE = "http://127.0.0.1:8000/health/live"
# The address that a client called is where its connection came in; nothing is sent to it here.
CALLED = "http://192.0.2.7:8000/health/live"
ALL = "0.0.0.0"  # noqa: S104 - nothing listens
LOOPBACK = ("127.0.0.1", "127.0.0.1:8000", "localhost:9", "LOCALHOST", "[::1]:8000", "[::1]")
OTHERS = ("mill.example", "127.0.0.1.evil.example", "evil:127.0.0.1", "")
WITH_USER = ("localhost@evil.example", "localhost:80@evil.example")


def test_names_of_the_service_are_answered_and_a_page_behind_a_proxy_that_speaks_tls_is_our_own(client, store):
    for variables, url, host, status in (
        *(({}, HERE, host, 200) for host in LOOPBACK),
        *(({}, HERE, host, 421) for host in (*OTHERS, *WITH_USER)),
        ({"allowed_hosts": ["Scanner.Mill"]}, HERE, "scanner.mill:8000", 200),
        # A loopback name is not answered from elsewhere, its own and allowed ones are.
        *(({"host": ALL}, CALLED, host, 421) for host in ("localhost", "127.0.0.1:8000", "[::1]", "0.0.0.0:8000")),
        ({"host": ALL}, HERE, "127.0.0.1:8000", 200),
        ({"host": ALL, "allowed_hosts": ["localhost"]}, CALLED, "localhost:8000", 200),
        ({"host": "192.0.2.7"}, CALLED, "192.0.2.7:8000", 200),
        ({"host": "scanner.mill"}, CALLED, "Scanner.Mill:8000", 200),
        ({"host": "2001:db8::7"}, CALLED, "[2001:db8::7]:8000", 200),
    ):
        client.app = create_app(ServiceSettings(**variables), store, print)
        answer = client.get(url, headers={"Host": host})
        assert answer.status_code == status
        assert status == 200 or answer.json()["code"] == "unknown-host"
    client.app = create_app(ServiceSettings(public_url="https://mill.example"), store, print)
    for origin, status in {"https": 401, "http": 401, "data": 403}.items():
        headers = {"Host": "mill.example", "Origin": f"{origin}://mill.example"}
        assert client.post("/v1/scanners", json=SPEC, headers=headers).status_code == status


def test_another_sites_page_may_read_and_change_nothing_and_every_answer_is_protected(client):
    origins = ("http://evil.example", "https://127.0.0.1:8000", "data://127.0.0.1:8000", "null")
    for headers in (
        *({"Origin": origin} for origin in origins),
        *({"Sec-Fetch-Site": site} for site in ("cross-site", "same-site")),
        {"Origin": "null", "Sec-Fetch-Site": "same-origin"},
    ):
        assert refusal(client.post("/v1/scanners", json=SPEC, headers=headers)) == (403, "other-site"), headers
        assert client.get("/v1/scanners").json()["items"] == []
        assert "Access-Control-Allow-Origin" not in client.get("/v1/scanners", headers=headers).headers
    for headers in ({}, {"Origin": "http://127.0.0.1:8000", "Sec-Fetch-Site": "same-origin"}):
        assert client.post("/v1/scanners", json=SPEC, headers=headers).status_code == 201
    for path in ("/", "/docs", "/v1/scanners", "/nothing", "/static/console.js"):
        headers = client.get(path).headers
        assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
    for path in ("/v1/keys", "/v1/keys/current", "/v1/audit", "/v1/audit.jsonl", "/v1/jobs", "/v1/nothing"):
        assert "no-store" in client.get(path).headers["Cache-Control"]
    assert client.get("/static/console.js").headers["Cache-Control"] == "no-cache"


def test_a_request_takes_no_thread_before_its_route_does():
    checks = (check_method, check_scope, check_csrf, check_query, check_body)
    given = [alias.__metadata__[0].dependency for name, alias in vars(dependencies).items() if name.startswith("The")]
    assert dependencies.TheStore.__metadata__[0].dependency in given
    # FastAPI runs every other function in a thread, and the request waits for it.
    assert [each for each in (*checks, *given) if not iscoroutinefunction(each)] == []


@pytest.fixture
def job_id(store) -> str:
    spec = ScanSpec(scanner_id=store.scanners.create(ScannerSpec.model_validate(SPEC)).id, data=DataKind.COUNTS)
    return store.scans.accept(spec, store.files.receive([b"scan"], max_bytes=9)).job_id


@pytest.fixture
def clock(moved_clock) -> Callable[[float], None]:
    """The library's windows are aligned to multiples of their length: tests begin 1 s after one, and move on."""
    moved_clock(stands_at_s=(now_s := 1_800_000_001.0))

    def pass_s(seconds: float) -> None:
        nonlocal now_s
        moved_clock(stands_at_s=(now_s := now_s + seconds))

    return pass_s


def test_requests_beyond_the_rate_of_their_kind_are_refused_until_there_is_room_again(limited, clock):
    client = limited(rate_limit="3/minute")
    assert [client.get("/v1/scanners").status_code for _ in range(4)] == [200, 200, 200, 429]
    refused = client.get("/v1/scanners")
    assert refused.json()["code"] == "too-many-requests"
    assert refused.json()["detail"] == "127.0.0.1 may send 3 requests in 60 s, and has: try again in 59 s"
    assert refused.headers["Retry-After"] == "59"
    clock(59.0 + 30.0)  # half a window later half of what was sent before has run out
    assert client.get("/v1/scanners").status_code == 200
    client = limited(change_rate_limit="1/hour")
    assert client.post("/v1/scanners", json=SPEC).status_code == 201
    assert (client.post("/v1/scanners", json=SPEC).status_code, client.get("/v1/scanners").status_code) == (429, 200)
    client = limited(rate_limit="1/hour")
    assert [client.get("/v1/scanners").status_code for _ in range(2)] == [200, 429]
    assert client.get("/health/live").status_code == 200
    client = limited(rate_limit="3/minute", token=SecretStr("t" * 40))
    assert [client.get("/v1/scanners").status_code for _ in range(5)] == [401, 401, 401, 429, 429]


def test_wrong_keys_of_an_address_are_counted_and_a_million_addresses_leave_bounded_counts(clock):
    logins = FailedLogins("2/minute")
    for secret in ("a", "b"):
        logins.failed("2001:db8::2", secret)
    with pytest.raises(Refused, match="wrong keys"):
        logins.failed("2001:db8::beef", "c")
    logins.failed("2001:db8:0:1::2", "c")
    clock(120.0)
    logins.failed("2001:db8::2", "d")
    memory = BoundedMemory(most_counts=100)
    for number in range(1000):
        memory.incr(f"requests/{number}", 120)
        clock(0.01)
    assert len(memory.storage) <= 100
    assert memory.get("requests/999") == 1
    clock(130.0)
    memory.incr("another", 120)
    assert len(memory.expirations) == len(memory.storage) <= 100
    assert not memory.locks
    for text in ("many", "0/minute", "5", "5/fortnight", ""):
        with pytest.raises(ValidationError, match="must be as in 1200/minute"):
            ServiceSettings(rate_limit=text)


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


def test_a_head_that_is_too_large_is_refused_though_it_came_at_once(client):
    for path in (f"/v1/{'a' * 21_000}", f"/v1/scanners?cursor={'a' * 21_000}"):
        assert refusal(client.get(path)) == (431, "head-too-large")
    long, many = {f"name-{number}": "b" * 300 for number in range(70)}, {f"a-{number}": "b" for number in range(101)}
    for headers, code in ((long, "head-too-large"), (many, "too-many-headers")):
        assert refusal(client.get("/v1/scanners", headers=headers)) == (431, code)


def test_who_does_not_wait_takes_no_place_of_those_who_do(limited, store, job_id):
    client = limited(max_waits_at_once=1, event_poll_s=0.01)
    path, begun = f"/v1/jobs/{job_id}", asyncio.Event()

    class Followed(EventFeed):
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
            assert ["cancelled" in answer.text for answer in await asyncio.gather(*waiting)] == [True] * most
            again = await asyncio.gather(*[http.get(address) for _ in range(most)])
            assert {answer.status_code for answer in again} == {200}

    asyncio.run(story())


def test_a_display_finds_a_stream_when_other_keys_have_taken_theirs(limited, store):
    client = limited(max_streams=4, event_poll_s=0.01)
    keys = [store.keys.create(KeyRequest(name=name, scope=Scope.READ)) for name in ("first", "second")]
    display = store.keys.create(KeyRequest(name="wall", scope=Scope.READ, display=True))

    async def story() -> None:
        async with asynchronous(client.app) as http:

            def follow(key: NewKey) -> asyncio.Task[httpx.Response]:
                return asyncio.create_task(http.get("/v1/events", headers={"Authorization": f"Bearer {key.secret}"}))

            streams = [follow(key) for key in (*keys, *keys)]
            refused, open_streams = await asyncio.wait(streams, timeout=60, return_when=asyncio.FIRST_COMPLETED)
            assert ["3 streams of events are open" in task.result().text for task in refused] == [True]
            displays = [follow(display) for _ in range(2)]
            refused, on_the_wall = await asyncio.wait(displays, timeout=60, return_when=asyncio.FIRST_COMPLETED)
            assert ["4 streams of events are open" in task.result().text for task in refused] == [True]
            client.app.state.stopping.begin()
            assert {answer.status_code for answer in await asyncio.gather(*open_streams, *on_the_wall)} == {200}

    asyncio.run(story())


REQUESTS = Path(__file__).parents[2] / "openapi" / "requests"
PLANS = "/v1/phantoms/l-shape/plans"
AT_ONCE, IN_ALL, OF_A_KEY = 20, 9, 6


def plan(number):
    return {"scanner_id": "example", "views": 20 + number}


def bounded(store, settings, **limits):
    limits = {f"max_queued_jobs{name}": most for name, most in limits.items()}
    again = Store(store.settings.model_copy(update=limits))
    return create_app(settings, again, print), again


@pytest.fixture
def full(seeded, store, settings):
    seeded.app, again = bounded(store, settings, **{"": 1})
    store.plans.accept(PlanRequest(**plan(0)), given={"phantom_id": "l-shape"})
    yield seeded
    again.close()


@pytest.fixture(params=["sqlite", "postgresql"])
def each_store(request):
    if request.param == "postgresql":
        return request.getfixturevalue("postgresql_store")
    return request.getfixturevalue("store")


@pytest.mark.slow
@pytest.mark.usefixtures("seeded")
def test_of_many_at_once_exactly_as_many_are_accepted_as_there_are_places(each_store):
    """Through one event loop and two services on one database, as behind a proxy; two keys, and all together."""
    settings = ServiceSettings()
    apps = [bounded(each_store, settings, **{"": IN_ALL, "_per_key": OF_A_KEY}) for _ in range(2)]
    keys = [each_store.keys.create(KeyRequest(name=f"line {number}", scope=Scope.SUBMIT)) for number in range(2)]

    # Of files: an ask for anything else locks what it refers to, and so keeps others waiting by accident.
    async def ask(app, key, number):
        headers = {"Authorization": f"Bearer {key.secret}", "Content-Type": "application/octet-stream"}
        async with asynchronous(app, **headers) as client:
            return await client.post("/v1/inspections", content=f"file {number}".encode())

    async def ask_all(key):
        return await asyncio.gather(*[ask(apps[number % 2][0], key, number) for number in range(AT_ONCE)])

    answers = [asyncio.run(ask_all(key)) for key in keys]
    for _, opened in apps:
        opened.close()
    statuses = [Counter(answer.status_code for answer in of_key) for of_key in answers]
    assert statuses == [{202: OF_A_KEY, 429: AT_ONCE - OF_A_KEY}, {202: IN_ALL - OF_A_KEY, 429: 17}]
    assert [{answer.json()["detail"] for answer in of_key if answer.status_code == 429} for of_key in answers] == [
        {"6 jobs wait, and 6 of one key may (SAWMILL_MAX_QUEUED_JOBS_PER_KEY), here of 'line 0': try again in 60 s"},
        {"9 jobs wait, and 9 may in all (SAWMILL_MAX_QUEUED_JOBS): try again in 60 s"},
    ]
    assert each_store.places.waiting().in_all == IN_ALL


WITH_FILE = ("inspect_file", "upload_phantom_picture", "upload_scan")
QUEUED = ("calibration", "drift", "fixed_pairs", "pair_log", "plan", "reconstruction")
ASKING = (*(f"create_{each}" for each in QUEUED), *WITH_FILE)


def test_each_way_to_ask_for_a_job_is_refused_and_nothing_is_made(full, store):
    operations = [item["post"] for item in committed()["paths"].values() if "post" in item]
    assert {post["operationId"] for post in operations if "202" in post["responses"]} == {*ASKING, "cancel_job"}
    for name in ASKING:
        example = json.loads((REQUESTS / f"{name}.json").read_text())
        if example["body_file"]:
            options = with_file(example, full.get(example["body_file"]).content)
        else:
            options = {"json": example["body"]}
        before = store.events.newest_number()
        answer = full.post(example["path"], params=example["query"], **options)
        assert refusal(answer) == (429, "queue-full"), answer.text
        assert answer.json()["detail"] == "1 jobs wait, and 1 may in all (SAWMILL_MAX_QUEUED_JOBS): try again in 60 s"
        assert answer.headers["Retry-After"] == "60"
        check_documented(answer)
        assert store.events.newest_number() == before


def test_a_repeat_of_what_was_accepted_gets_its_answer(seeded, store, settings):
    seeded.app, again = bounded(store, settings, **{"": 2})
    file = seeded.get("/examples/phantom-scan.npz").content
    sent = {"content": file, "headers": {"Content-Type": "application/octet-stream"}}
    asked = {PLANS: {"json": plan(1)}, "/v1/scans?scanner_id=example&data=counts": sent}
    for path, options in asked.items():
        options["headers"] = options.get("headers", {}) | {"Idempotency-Key": path[4:9]}
        assert seeded.post(path, **options).status_code == 202
    for path, options in asked.items():
        repeated = seeded.post(path, **options)
        assert (repeated.status_code, repeated.headers["Idempotency-Replayed"]) == (202, "true")
        other = options | {"headers": options["headers"] | {"Idempotency-Key": "another"}}
        assert seeded.post(path, **other).status_code == 429
    again.close()


def test_whoever_watches_sees_how_full_it_is(full, store, settings):
    scrape = full.get("/metrics").text
    assert absent(scrape, "sawmill_queued_jobs_limit 1.0", "sawmill_queued_jobs_of_a_key_limit 5000.0") == []
    assert "sawmill_queued_jobs_of_a_key 0.0" in scrape
    text = text_of(full.get("/system").text)
    assert "Jobs that wait Full Now 1 of 1 allowed" in text
    assert "More jobs are refused until some of these are done." in text
    key = store.keys.create(KeyRequest(name="line 2", scope=Scope.SUBMIT))
    full.app, again = bounded(store, settings, **{"": 10, "_per_key": 2})
    full.post(PLANS, json=plan(1), headers={"Authorization": f"Bearer {key.secret}"})
    assert "sawmill_queued_jobs_of_a_key 1.0" in full.get("/metrics").text
    assert "Jobs that wait Room enough Now 2 of 10 allowed Most of one key 1 of 2 allowed, line 2" in text_of(
        full.get("/system").text
    )
    again.close()


def test_a_person_is_told_on_the_page_and_a_file_that_came_in_parts_waits_for_its_place(full, store):
    page = full.post("/scans/example/reconstruct", data={"size": "64"}, headers={"Accept": "text/html"})
    assert page.status_code == 429
    assert "1 jobs wait, and 1 may in all (SAWMILL_MAX_QUEUED_JOBS): try again in 60 s" in text_of(page.text)
    file = full.get("/examples/phantom-scan.npz").content
    upload = full.post("/v1/uploads", json={"size_bytes": len(file)})
    part = {"Upload-Offset": "0", "Upload-Complete": "?1", "Content-Type": "application/octet-stream"}
    full.request("PATCH", upload.headers["Location"], headers=part, content=file)
    query = {"scanner_id": "example", "data": "counts", "upload_id": upload.json()["id"]}
    assert full.post("/v1/scans", params=query).json()["code"] == "queue-full"
    store.jobs.claim("test")
    assert full.post("/v1/scans", params=query).status_code == 202
