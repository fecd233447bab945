"""429 `queue-full`: every way to ask for a job, many at once, on both databases, and what people see of it."""

import asyncio
import json
from collections import Counter
from pathlib import Path

import pytest
from asgi import asynchronous
from documented import check_documented, committed
from example_requests import with_file
from page_text import absent, text_of

from sawmill_contracts.plans import PlanAsk
from sawmill_platform.contracts.keys import KeyAsk, Scope
from sawmill_service.app import create_app
from sawmill_service.settings import ServiceSettings
from sawmill_store.store import Store

REQUESTS = Path(__file__).parents[2] / "openapi" / "requests"
PLANS = "/v1/phantoms/l-shape/plans"
AT_ONCE, IN_ALL, OF_A_KEY = 20, 9, 6


def plan(number):
    return {"scanner_id": "example", "views": 20 + number}


def limited(store, settings, **limits):
    """The same data behind a service with these limits."""
    limits = {f"max_queued_jobs{name}": most for name, most in limits.items()}
    again = Store(store.settings.model_copy(update=limits))
    return create_app(settings, again, print), again


@pytest.fixture
def full(seeded, store, settings):
    """The client of a service whose one place is taken."""
    seeded.app, again = limited(store, settings, **{"": 1})
    store.plans.accept(PlanAsk(**plan(0)), given={"phantom_id": "l-shape"})
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
    apps = [limited(each_store, settings, **{"": IN_ALL, "_per_key": OF_A_KEY}) for _ in range(2)]
    keys = [each_store.keys.create(KeyAsk(name=f"line {number}", scope=Scope.SUBMIT)) for number in range(2)]

    # Of files: an ask for anything else locks what it refers to, and so keeps others waiting by accident.
    async def ask(app, key, number):
        headers = {"Authorization": f"Bearer {key.secret}", "Content-Type": "application/octet-stream"}
        async with asynchronous(app, **headers) as client:
            return await client.post("/v1/inspections", content=f"file {number}".encode())

    async def ask_all(key):
        asked = [ask(apps[number % 2][0], key, number) for number in range(AT_ONCE)]
        return await asyncio.gather(*asked)

    answers = [asyncio.run(ask_all(key)) for key in keys]
    for _, opened in apps:
        opened.close()
    statuses = [Counter(answer.status_code for answer in of_key) for of_key in answers]
    assert statuses == [{202: OF_A_KEY, 429: AT_ONCE - OF_A_KEY}, {202: IN_ALL - OF_A_KEY, 429: 17}]
    details = [{answer.json()["detail"] for answer in of_key if answer.status_code == 429} for of_key in answers]
    assert details == [
        {"6 jobs wait, and 6 of one key may (SAWMILL_MAX_QUEUED_JOBS_PER_KEY), here of 'line 0': try again in 60 s"},
        {"9 jobs wait, and 9 may in all (SAWMILL_MAX_QUEUED_JOBS): try again in 60 s"},
    ]
    assert each_store.places.waiting().in_all == IN_ALL


WITH_FILE = ("inspect_file", "upload_phantom_picture", "upload_scan")
ASKING = ("ask_calibration", "ask_drift", "ask_plan", "ask_reconstruction", *WITH_FILE)


def test_these_are_all_that_ask_for_a_job():
    operations = [item["post"] for item in committed()["paths"].values() if "post" in item]
    assert {post["operationId"] for post in operations if "202" in post["responses"]} == {*ASKING, "cancel_job"}


@pytest.mark.parametrize("name", ASKING)
def test_each_way_to_ask_is_refused_and_nothing_is_made(full, store, name):
    example = json.loads((REQUESTS / f"{name}.json").read_text())
    if example["body_file"]:
        options = with_file(example, full.get(example["body_file"]).content)
    else:
        options = {"json": example["body"]}
    before = store.events.newest_number()
    answer = full.post(example["path"], params=example["query"], **options)
    assert (answer.status_code, answer.json()["code"]) == (429, "queue-full"), answer.text
    assert answer.json()["detail"] == "1 jobs wait, and 1 may in all (SAWMILL_MAX_QUEUED_JOBS): try again in 60 s"
    assert answer.headers["Retry-After"] == "60"
    check_documented(answer)
    assert store.events.newest_number() == before


def test_a_file_that_came_in_parts_waits_for_its_place(full, store):
    file = full.get("/examples/phantom-scan.npz").content
    upload = full.post("/v1/uploads", json={"size_bytes": len(file)})
    part = {"Upload-Offset": "0", "Upload-Complete": "?1", "Content-Type": "application/octet-stream"}
    full.request("PATCH", upload.headers["Location"], headers=part, content=file)
    query = {"scanner_id": "example", "data": "counts", "upload_id": upload.json()["id"]}
    assert full.post("/v1/scans", params=query).json()["code"] == "queue-full"
    store.jobs.claim("test")
    assert full.post("/v1/scans", params=query).status_code == 202


def test_a_repeat_of_what_was_accepted_gets_its_answer(seeded, store, settings):
    seeded.app, again = limited(store, settings, **{"": 2})
    file = seeded.get("/examples/phantom-scan.npz").content
    asked = {
        PLANS: {"json": plan(1)},
        "/v1/scans?scanner_id=example&data=counts": {
            "content": file,
            "headers": {"Content-Type": "application/octet-stream"},
        },
    }
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
    assert "Whoever asks for more is refused until jobs have been done." in text
    key = store.keys.create(KeyAsk(name="line 2", scope=Scope.SUBMIT))
    full.app, again = limited(store, settings, **{"": 10, "_per_key": 2})
    full.post(PLANS, json=plan(1), headers={"Authorization": f"Bearer {key.secret}"})
    assert "sawmill_queued_jobs_of_a_key 1.0" in full.get("/metrics").text
    assert "Jobs that wait Room enough Now 2 of 10 allowed Most of one key 1 of 2 allowed, line 2" in text_of(
        full.get("/system").text
    )
    again.close()


def test_a_person_who_asks_for_a_log_is_told_on_the_page(full):
    page = full.post("/scans/example/reconstruct", data={"size": "64"}, headers={"Accept": "text/html"})
    assert page.status_code == 429
    assert "1 jobs wait, and 1 may in all (SAWMILL_MAX_QUEUED_JOBS): try again in 60 s" in text_of(page.text)
