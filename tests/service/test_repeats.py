"""`Idempotency-Key` over HTTP: a request that is sent again makes nothing again, many at once neither."""

import asyncio
import gzip
import threading
from base64 import b64encode
from concurrent.futures import ThreadPoolExecutor

import pytest
from asgi import asynchronous, refusal
from results import SCANNER_SPEC as SCANNER

from sawmill_contracts import kinds
from sawmill_platform.contracts.keys import KeyRequest, Scope
from sawmill_platform.contracts.uploads import UploadRequest
from sawmill_platform.database.tables import RepeatRow
from sawmill_platform.files.upload_stream import AsSent
from sawmill_platform.keys.repeats import Repeats
from sawmill_platform.uploads.upload_store import UploadQuota
from sawmill_service.app import create_app
from sawmill_service.http.bodies.sent_content import SentContent

ASK = {"scan_id": "example", "seed": 4}
DISC = {"name": "disc", "shapes": [{"kind": "disc", "center_mm": [0, 0], "radius_mm": 50}]}
LENGTH = {"dimension": "x", "measured_mm": 200.1, "standard_uncertainty_mm": 0.05, "measured_on": "2026-01-02"}
REQUESTS = {
    "/v1/calibrations": {"json": ASK},
    "/v1/calibrations/example/activate": {},
    "/v1/reconstructions": {"json": {"scan_id": "example"}},
    "/v1/drifts": {"json": {"scan_id": "example"}},
    "/v1/phantoms/l-shape/plans": {"json": {"scanner_id": "example", "views": 20}},
    "/v1/phantoms": {"json": DISC},
    "/v1/phantoms/l-shape/measurements": {"json": {"measurements": [LENGTH]}},
    "/v1/phantoms/pictures?name=ell&width_mm=400": {"content": b"no picture"},
    "/v1/scans?scanner_id=example&data=counts": {"content": b"no scan"},
    "/v1/scans?scanner_id=example&data=counts&inspection_id=example": {},
    "/v1/inspections": {"content": b"no scan"},
    "/v1/scanners": {"json": SCANNER},
    "/v1/schedules": {"json": {"scanner_id": "example", "cron": "30 5 * * 1-6"}},
}


def named(key):
    return {"Idempotency-Key": key}


def numbers(store):
    lists = (store.scans, store.calibrations, store.reconstructions, store.drifts, store.plans, store.inspections)
    lists += (store.scanners, store.phantoms, store.schedules, store.jobs)
    return [len(each.page(limit=200).items) for each in lists]


@pytest.mark.parametrize("path", REQUESTS)
def test_a_repeat_makes_nothing_and_gets_the_first_answer(seeded, store, woken, path):
    first = seeded.post(path, headers=named('"once"'), **REQUESTS[path])
    assert first.status_code in {200, 201, 202}, first.text
    made, woken_once = numbers(store), len(woken)
    again = seeded.post(path, headers=named('"once"'), **REQUESTS[path])
    assert (again.content, again.status_code) == (first.content, first.status_code)
    same = ("Location", "Retry-After", "Content-Type")
    assert [again.headers.get(name) for name in same] == [first.headers.get(name) for name in same]
    assert (first.headers.get("Idempotency-Replayed"), again.headers["Idempotency-Replayed"]) == (None, "true")
    assert (numbers(store), len(woken)) == (made, woken_once)
    assert not list((store.files.folder / "incoming").iterdir())


def test_keys_are_documented_may_stand_in_quotes_and_bad_ones_are_refused(seeded):
    for (path, method), names in {
        (path, method): [parameter["name"] for parameter in operation.get("parameters", [])]
        for path, item in seeded.app.openapi()["paths"].items()
        for method, operation in item.items()
    }.items():
        assert ("Idempotency-Key" in names) is (method == "post"), (path, method)
    made = seeded.app.openapi()["paths"]["/v1/scanners"]["post"]["responses"]["201"]
    assert made["headers"]["Idempotency-Replayed"]["schema"]["const"] == "true"
    first = seeded.post("/v1/scanners", json=SCANNER, headers=named('"a\\"b"'))
    assert seeded.post("/v1/scanners", json=SCANNER, headers=named('a"b')).status_code == 400
    other = seeded.post("/v1/scanners", json=SCANNER, headers=named('"ab"'))
    assert seeded.post("/v1/scanners", json=SCANNER, headers=named("ab")).content == other.content
    assert first.json()["id"] != other.json()["id"]
    for bad in ("", '""', "two words", '"half', "k" * 201):
        refused = seeded.post("/v1/scanners", json=SCANNER, headers=named(bad))
        assert refusal(refused) == (400, "bad-idempotency-key"), bad


def test_the_key_of_another_request_is_refused_and_that_of_another_caller_is_another(seeded, store):
    seeded.post("/v1/calibrations", json=ASK, headers=named("once"))
    made = numbers(store)
    for path, options in (
        ("/v1/calibrations", {"json": ASK | {"seed": 5}}),
        ("/v1/calibrations?priority=batch", {"json": ASK}),
        ("/v1/reconstructions", {"json": {"scan_id": "example"}}),
        ("/v1/scans?scanner_id=example&data=counts", {"content": b"no scan"}),
    ):
        refused = seeded.post(path, headers=named("once"), **options)
        assert refusal(refused) == (422, "idempotency-key-reused"), refused.text
        assert "take a new key" in refused.json()["detail"]
    assert numbers(store) == made
    seeded.post("/v1/calibrations", json=ASK, headers=named("once"))
    ids = set()
    for name in ("one", "other"):
        secret = store.keys.create(KeyRequest(name=name, scope=Scope.SUBMIT)).secret
        headers = named("once") | {"Authorization": f"Bearer {secret}"}
        ids |= {seeded.post("/v1/calibrations", json=ASK, headers=headers).json()["id"] for _ in range(2)}
    assert (len(ids), len(store.jobs.page(kind=kinds.CALIBRATE).items)) == (2, 5)


def test_another_file_under_the_same_key_is_refused_and_not_kept(seeded, store):
    path = "/v1/scans?scanner_id=example&data=counts"
    first = seeded.post(path, content=b"one scan", headers=named("once"))
    made = numbers(store)
    assert refusal(seeded.post(path, content=b"two scans", headers=named("once"))) == (422, "idempotency-key-reused")
    assert seeded.post(path, content=b"", headers=named("once")).json()["code"] == "empty-body"
    # Nor is more of it read than an upload may have (100 000 bytes here).
    packed = {"Content-Encoding": "gzip", **named("once")}
    assert seeded.post(path, content=gzip.compress(bytes(100_001)), headers=packed).status_code == 413
    assert (numbers(store), len(list((store.files.folder / "uploads" / "scans").iterdir()))) == (made, 3)
    store.jobs.request_cancel(first.json()["job_id"])
    store.scans.delete(first.json()["id"])
    again = seeded.post(path, content=b"one scan", headers=named("once"))
    assert again.content == first.content, "the first answer, whatever has become of what it made"


@pytest.mark.parametrize("name", ["inspection_id", "upload_id"])
def test_a_repeat_that_names_a_file_has_no_body_and_the_digest_of_none(seeded, name):
    earlier = "example"
    if name == "upload_id":
        earlier = seeded.post("/v1/uploads", json={"size_bytes": 6}).json()["id"]
        seeded.request("PATCH", f"/v1/uploads/{earlier}", content=b"a scan", headers={"Upload-Offset": "0"})
    path, key = f"/v1/scans?scanner_id=example&data=counts&{name}={earlier}", named("once")
    wrong = f"sha-256=:{b64encode(bytes(32)).decode()}:"
    first = seeded.post(path, headers=key)
    assert (first.status_code, seeded.post(path, content=b"a scan", headers=key).json()["code"]) == (202, "two-files")
    assert seeded.post(path, headers=key | {"Content-Digest": wrong}).json()["code"] == "digest-mismatch"
    assert seeded.post(path, headers=key).content == first.content


def test_a_refused_request_may_be_mended_and_a_secret_is_in_the_first_answer_alone(seeded, store):
    assert seeded.post("/v1/calibrations", json={"scan_id": "gone"}, headers=named("once")).status_code == 404
    mended = seeded.post("/v1/calibrations", json=ASK, headers=named("once"))
    assert (mended.status_code, mended.headers.get("Idempotency-Replayed")) == (202, None)
    job_id = seeded.post("/v1/calibrations", json=ASK).json()["job_id"]
    for number, path in enumerate([f"/v1/jobs/{job_id}/cancel", "/v1/jobs/example/cancel"]):
        first = seeded.post(path, headers=named(f"once-{number}"))
        assert (first.status_code, seeded.post(path, headers=named(f"once-{number}")).content) == (202, first.content)
    assert store.jobs.get(job_id).state == "cancelled"
    made = seeded.post("/v1/keys", json={"name": "line 2", "scope": "read"}, headers=named("key"))
    rotated = seeded.post(f"/v1/keys/{made.json()['id']}/rotate", headers=named("rotation"))
    for first, path, options in (
        (made, "/v1/keys", {"json": {"name": "line 2", "scope": "read"}}),
        (rotated, f"/v1/keys/{made.json()['id']}/rotate", {}),
    ):
        secret = first.json()["secret"]
        again = seeded.post(path, headers=named({made: "key", rotated: "rotation"}[first]), **options)
        assert refusal(again) == (409, "secret-not-repeated")
        assert made.json()["id"] in again.json()["detail"]
        with store.database.read() as session:
            kept = str([row.answer for row in session.query(RepeatRow)])
        assert "line 2" in kept
        assert secret not in kept
    assert len(store.keys.all()) == 1


AT_ONCE = 8
CONTENT = b"a scan or a picture"
PATHS = {
    "scans": "/v1/scans?scanner_id=example&data=counts&upload_id={}",
    "phantoms": "/v1/phantoms/pictures?name=ell&width_mm=400&upload_id={}",
    "inspections": "/v1/inspections?upload_id={}",
}


@pytest.fixture
def each_store(request):
    if request.param == "postgresql":
        return request.getfixturevalue("postgresql_store")
    request.getfixturevalue("seeded")
    return request.getfixturevalue("store")


@pytest.mark.parametrize(
    ("each_store", "kind"),
    [
        *(("sqlite", kind) for kind in PATHS),
        ("postgresql", "scans"),
        pytest.param("postgresql", "phantoms", marks=pytest.mark.nightly),
        pytest.param("postgresql", "inspections", marks=pytest.mark.nightly),
    ],
    indirect=["each_store"],
)
def test_all_that_use_one_upload_under_one_key_get_one_answer(seeded, each_store, settings, kind):
    """Half of them come to the upload only when it has been used, though nobody had an answer when they looked."""
    seeded.app = create_app(settings, each_store, print)
    seeded.get("/health/live")  # the first request puts the application together
    upload = each_store.uploads.create(UploadRequest(size_bytes=len(CONTENT)), UploadQuota(9, 2**30, 2**30))
    part = each_store.uploads.begin_part(upload.id, 0)
    part.take(AsSent(), CONTENT, commits=False)
    part.finish(AsSent())
    part.complete()
    part.close()
    path = PATHS[kind].format(upload.id)
    looked, answered, in_time = threading.Barrier(AT_ONCE), threading.Event(), threading.Semaphore(AT_ONCE // 2)
    again = threading.local()

    class FoundTogether(Repeats):
        def find(self, request):
            kept = super().find(request)
            if not hasattr(again, "looked"):
                again.looked = True
                looked.wait(60)
                if not in_time.acquire(blocking=False):
                    assert answered.wait(60)
            return kept

    each_store.repeats = FoundTogether(each_store.database)

    def send(_):
        answer = seeded.post(path, headers={"Idempotency-Key": "once"})
        answered.set()
        return answer

    with ThreadPoolExecutor(AT_ONCE) as pool:
        answers = list(pool.map(send, range(AT_ONCE)))
    assert {answer.status_code for answer in answers} == {202}, [answer.text for answer in answers]
    assert len({(answer.content, answer.headers["Location"]) for answer in answers}) == 1
    assert sum("Idempotency-Replayed" in answer.headers for answer in answers) == AT_ONCE - 1


@pytest.mark.slow
def test_repeats_that_last_keep_nobody_else_waiting(seeded, settings, store, monkeypatch):
    """More repeats than the service has threads: an upload is served meanwhile."""
    seeded.app = create_app(settings.model_copy(update={"max_bodies_at_once": 1000}), store, print)
    scans, packed = "/v1/scans?scanner_id=example&data=counts", gzip.compress(CONTENT)
    keyed = {"Content-Encoding": "gzip", "Idempotency-Key": "once"}
    assert seeded.post(scans, content=packed, headers=keyed).status_code == 202
    held, take = threading.Event(), SentContent.take

    def take_later(body, part):
        assert part == CONTENT or held.wait(120)
        yield from take(body, part)

    monkeypatch.setattr(SentContent, "take", take_later)
    begun, all_begun = [], asyncio.Event()

    async def counted():
        begun.append(packed)
        if len(begun) == 45:
            all_begun.set()
        yield packed

    async def send_all():
        """One event loop, as in the service: its threads are those that all requests share."""
        async with asynchronous(seeded.app) as client:
            repeats = [asyncio.create_task(client.post(scans, content=counted(), headers=keyed)) for _ in range(45)]
            try:
                async with asyncio.timeout(120):
                    await all_begun.wait()
                    other = await client.post(scans, content=CONTENT)
                waited = not any(task.done() for task in repeats)
            finally:
                held.set()
            return other, waited, await asyncio.gather(*repeats)

    other, waited, repeats = asyncio.run(send_all())
    assert (other.status_code, waited) == (202, True), other.text
    assert {answer.headers.get("Idempotency-Replayed") for answer in repeats} == {"true"}
