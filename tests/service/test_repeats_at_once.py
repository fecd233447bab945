"""One key and one upload at the same time, over HTTP: every repeat gets the first answer, on both databases."""

import asyncio
import gzip
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from asgi import asynchronous

from sawmill_platform.contracts.uploads import UploadAsk
from sawmill_platform.files.upload_stream import AsSent
from sawmill_platform.keys.repeats import Repeats
from sawmill_platform.uploads.upload_store import UploadQuota
from sawmill_service.app import create_app
from sawmill_service.http.bodies.sent_content import SentContent

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


def complete_upload(store):
    upload = store.uploads.create(UploadAsk(size_bytes=len(CONTENT)), UploadQuota(9, 2**30, 2**30))
    part = store.uploads.begin_part(upload.id, 0)
    part.take(AsSent(), CONTENT, commits=False)
    part.finish(AsSent())
    part.complete()
    part.close()
    return upload.id


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
    path = PATHS[kind].format(complete_upload(each_store))
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
        """Take long over all but the plain file."""
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
