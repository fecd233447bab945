"""Downloads as programs meet them: tags and digests of the bytes, ranges, and names."""

import asyncio
import hashlib
import os
import re
from base64 import b64encode
from threading import Event

import pytest
from asgi import absent, asynchronous, refusal
from documented import check_documented

from sawmill_contracts import kinds
from sawmill_platform.files.verified_results import VerifiedResults
from sawmill_service.app import create_app
from sawmill_service.http.responses.conditional import Digests
from sawmill_service.settings import ServiceSettings

LOG, FOUND = "/v1/reconstructions/example", "/v1/calibrations/example"
VOLUME, VOLUME_PATH = f"{LOG}/volume.h5", "reconstructions/example/volume.h5"
UNCHANGING = "private, max-age=43200, immutable"
PICTURES = (f"{LOG}/slices/1.png", f"{LOG}/slices/1.jpg", f"{LOG}/thumbnail.png", f"{FOUND}/overlay.png")
DRAWN = ("/v1/scans/example/sinogram.png?row=1", "/v1/phantoms/l-shape/drawing.svg", "/v1/scans/example/preview")
STORED = (f"{LOG}/slices/1.npy", VOLUME, f"{FOUND}/result.h5")
FILES = dict.fromkeys((*PICTURES, *DRAWN), "inline") | dict.fromkeys(STORED, "attachment")


def test_a_download_is_known_by_its_bytes(seeded):
    for path in FILES:
        whole = seeded.get(path)
        digest, headers = hashlib.sha256(whole.content).digest(), whole.headers
        assert headers["ETag"] == f'"{digest.hex()}"'
        assert headers["Repr-Digest"] == f"sha-256=:{b64encode(digest).decode()}:"
        kept = UNCHANGING if path.endswith((".jpg", ".npy")) else "private, no-cache"
        assert (headers["Accept-Ranges"], headers["Cache-Control"]) == ("bytes", kept)
        assert headers.get("Vary") == ("Authorization, Cookie" if kept == UNCHANGING else None)
        assert int(headers["Content-Length"]) == len(whole.content)
        assert headers["Content-Disposition"].startswith(f'{FILES[path]}; filename="')
        assert re.search("example|l-shape|Line", headers["Content-Disposition"])
        held = seeded.get(path, headers={"If-None-Match": headers["ETag"]})
        assert (held.status_code, held.content, held.headers["ETag"]) == (304, b"", headers["ETag"])
        assert held.headers["Cache-Control"] == kept
        part = seeded.get(path, headers={"Range": "bytes=3-12", "If-Range": headers["ETag"]})
        assert (part.status_code, part.content) == (206, whole.content[3:13])
        assert part.headers["Content-Range"] == f"bytes 3-12/{len(whole.content)}"
        assert part.headers["Repr-Digest"] == headers["Repr-Digest"]
        assert seeded.get(path, headers={"Range": "bytes=-5"}).content == whole.content[-5:]
        other = seeded.get(path, headers={"Range": "bytes=3-12", "If-Range": '"of-before"'})
        assert (other.status_code, other.content) == (200, whole.content)
        beyond = seeded.get(path, headers={"Range": f"bytes={len(whole.content)}-"})
        assert (beyond.status_code, beyond.headers["Content-Range"]) == (416, f"bytes */{len(whole.content)}")
        assert seeded.get(path, headers={"Range": "bytes=5-3"}).status_code == 400


def test_the_contract_and_the_audit_are_sent_once_to_who_holds_them(seeded):
    whole = seeded.get("/openapi.json")
    assert whole.headers["ETag"] == f'"{hashlib.sha256(whole.content).hexdigest()}"'
    assert whole.headers["Content-Type"] == "application/json"
    assert whole.headers["Content-Disposition"] == 'inline; filename="openapi.json"'
    held = seeded.get("/openapi.json", headers={"If-None-Match": whole.headers["ETag"]})
    assert (held.status_code, held.content) == (304, b"")
    first = seeded.get("/v1/audit.jsonl")
    assert first.headers["ETag"].startswith('W/"')
    held = {"If-None-Match": first.headers["ETag"]}
    unchanged = seeded.get("/v1/audit.jsonl", headers=held)
    check_documented(unchanged)
    assert (unchanged.status_code, unchanged.content) == (304, b"")
    seeded.delete("/v1/schedules/example-spare")
    longer = seeded.get("/v1/audit.jsonl", headers=held)
    check_documented(longer)
    assert longer.text.startswith(first.text)
    assert longer.text.count("\n") == first.text.count("\n") + 1


def test_a_picture_is_drawn_once_for_head_and_get_and_a_file_gone_before_it_was_read_is_a_problem(seeded, store):
    path = f"{LOG}/slices/2.png"
    head = seeded.request("HEAD", path)
    (store.files.folder / VOLUME_PATH).write_bytes(b"of which nothing can be drawn")
    assert seeded.get(path).headers["ETag"] == head.headers["ETag"]

    class GoneMeanwhile(SlowResults):
        def digest(self, path):
            path.unlink()
            return super().digest(path)

    store.files.verified = slow = GoneMeanwhile(store)
    slow.go_on.set()
    assert refusal(seeded.get(VOLUME)) == (404, "file-missing")


class SlowResults(VerifiedResults):
    def __init__(self, store):
        super().__init__(store.jobs.digest_of_result, pytest.fail, pytest.fail)
        self.begun, self.go_on, self.computed = Event(), Event(), []

    def digest(self, path):
        if path.name == "volume.h5" and path not in self.computed:
            self.computed.append(path)
            self.begun.set()
            assert self.go_on.wait(60)
        return super().digest(path)


@pytest.mark.usefixtures("seeded")
def test_large_files_take_turns_and_small_ones_do_not_wait_for_them(store):
    app = create_app(ServiceSettings(), store, print)
    small, large = (store.files.folder / name for name in ("calibrations/example/result.h5", VOLUME_PATH))
    app.state.digests = Digests(read_at_once=1, large_from_bytes=small.stat().st_size + 1)
    os.truncate(large, 2 * small.stat().st_size)
    (store.files.folder / "scans/example/thumbnail.png").write_bytes(bytes(2 * small.stat().st_size))
    store.files.verified = slow = SlowResults(store)

    async def story():
        async with asynchronous(app) as client:
            asked = asyncio.create_task(client.get(VOLUME))
            try:
                assert await asyncio.to_thread(slow.begun.wait, 30)
                next_one = asyncio.create_task(client.get("/v1/scans/example/thumbnail.png"))
                async with asyncio.timeout(60):
                    answer = await client.get(f"{FOUND}/result.h5")
                await asyncio.sleep(0.2)
                assert (asked.done(), next_one.done()) == (False, False)
                return answer
            finally:
                slow.go_on.set()
                assert ((await asked).json()["code"], (await next_one).status_code) == ("result-damaged", 200)

    assert asyncio.run(story()).headers["ETag"] == f'"{hashlib.sha256(small.read_bytes()).hexdigest()}"'


@pytest.mark.usefixtures("seeded")
def test_many_that_wait_for_a_digest_hold_no_thread(store):
    """More than the service has threads; two that are gone meanwhile take nothing from the others."""
    app = create_app(ServiceSettings(max_requests_at_once=1000), store, print)
    store.files.verified = slow = SlowResults(store)

    async def story():
        async with asynchronous(app) as client:
            asked = [asyncio.create_task(client.get(VOLUME)) for _ in range(100)]
            assert await asyncio.to_thread(slow.begun.wait, 30)
            for given_up in asked[:2]:
                given_up.cancel()
            others = ["/v1/scanners", f"{FOUND}/result.h5", "/v1/scans/example/thumbnail.png"]
            async with asyncio.timeout(60):
                assert [(await client.get(other)).status_code for other in others] == [200] * 3
            assert not any(each.done() for each in asked[2:])
            slow.go_on.set()
            return await asyncio.gather(*asked[2:])

    answers = asyncio.run(story())
    tag = f'"{hashlib.sha256(store.files.volume("example").read_bytes()).hexdigest()}"'
    assert {(answer.status_code, answer.headers["ETag"]) for answer in answers} == {(200, tag)}
    assert len(slow.computed) == 1


# What is sent of each kind: a stored file, a picture, an array; None: the whole.
MANY = "9" * 5000
IGNORED = ("rows=1-2", "Rows=1-2, 4-5", "none=")
FIRST = ("BYTES=3-12", "Bytes=3-12", "bytes=3-12,", "bytes=,, 3-12 ,\t,", "bytes=3-12,999999999999-", "bytes=-0,3-12")
BAD = (
    *("bytes=", "bytes=,", "bytes=-", "bytes=x", "bytes=1-2,x", "bytes 1-2", "1-2", "=1-2", "bytes=5-2"),
    *(f"bytes={MANY}-", f"bytes=0-{MANY}", f"bytes=-{MANY}"),
)
SPANS = {
    **dict.fromkeys(IGNORED),
    **dict.fromkeys(FIRST, (3, 13)),
    **dict.fromkeys(("bytes=0-999999999999999999", "bytes=-999999999999999999"), (0, None)),
    **dict.fromkeys(BAD, 400),
    **dict.fromkeys(("bytes=-0", "bytes=999999999999-,-0"), 416),
}


def test_ranges_and_conditions_are_those_of_the_rfc(seeded):
    for path in (VOLUME, f"{LOG}/slices/1.png", f"{LOG}/slices/1.npy"):
        whole = seeded.get(path).content
        for header, expected in SPANS.items():
            answer = seeded.get(path, headers={"Range": header})
            if expected is None:
                assert (answer.status_code, answer.content) == (200, whole), header
            elif isinstance(expected, tuple):
                assert (answer.status_code, answer.content) == (206, whole[slice(*expected)]), header
            else:
                assert answer.status_code == expected, header
                assert answer.json()["code"] == {400: "bad-range", 416: "range-beyond-end"}[expected]
                check_documented(answer)
    for path in (VOLUME, f"{LOG}/slices/1.png", f"{LOG}/slices/1.npy"):
        tag = seeded.get(path).headers["ETag"]
        conditions = {f'"of-before", {tag}': 200, "*": 200, '"of-before"': 412, f"W/{tag}": 412, tag.strip('"'): 412}
        for given, status in conditions.items():
            answer = seeded.get(path, headers={"If-Match": given, "Range": "bytes=0-3"})
            assert answer.status_code == {200: 206}.get(status, status), given
            if status == 412:
                assert (answer.json()["code"], tag in answer.json()["detail"]) == ("precondition-failed", True)
                check_documented(answer)
        # The first condition that fails decides; a cache's comes after it.
        assert seeded.get(path, headers={"If-Match": '"of-before"', "If-None-Match": tag}).status_code == 412
        assert seeded.get(path, headers={"If-Match": tag, "If-None-Match": f'"x", W/{tag}'}).status_code == 304
        assert seeded.request("HEAD", path, headers={"If-Match": '"of-before"'}).status_code == 412


def test_a_file_is_sent_in_several_ranges_and_whole_where_they_are_too_many_or_of_a_date(seeded, store):
    whole = seeded.get(VOLUME).content
    several = seeded.get(VOLUME, headers={"Range": "bytes=0-3,,10-12,999999999999-"})
    assert several.status_code == 206
    assert several.headers["Content-Type"].startswith("multipart/byteranges")
    assert absent(several.content, whole[:4], f"bytes 10-12/{len(whole)}".encode()) == []
    many = ",".join(f"{first}-{first}" for first in range(0, 404, 4))
    assert seeded.get(VOLUME, headers={"Range": f"bytes={many}"}).content == whole
    # A file may be written twice within a second: parts of both are not to be joined.
    thumbnail = f"{LOG}/thumbnail.png"
    modified = seeded.get(thumbnail).headers["Last-Modified"]
    path = store.files.results(kinds.RECONSTRUCT, "example") / "thumbnail.png"
    status = path.stat()
    path.write_bytes(path.read_bytes()[::-1])
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns // 10**9 * 10**9 + (status.st_mtime_ns + 1) % 10**9))
    answer = seeded.get(thumbnail, headers={"Range": "bytes=0-9", "If-Range": modified})
    assert (answer.headers["Last-Modified"], answer.status_code, answer.content) == (modified, 200, path.read_bytes())


def test_conditions_of_time_are_kept_where_the_time_is_known(seeded):
    modified = seeded.get(VOLUME).headers["Last-Modified"]
    before, after = "Sun, 06 Nov 1994 08:49:37 GMT", "Sunday, 06-Nov-68 08:49:37 GMT"
    beyond = "Sun, 06 Nov 99999999999 08:49:37 GMT"
    unmodified = {modified: 200, after: 200, before: 412, "Sun Nov  6 08:49:37 1994": 412, "yesterday": 200}
    unmodified[beyond] = 200
    for given, status in unmodified.items():
        assert seeded.get(VOLUME, headers={"If-Unmodified-Since": given}).status_code == status, given
    for given, status in {modified: 304, after: 304, before: 200, "yesterday": 200, beyond: 200}.items():
        assert seeded.get(VOLUME, headers={"If-Modified-Since": given}).status_code == status, given
    tag = seeded.get(VOLUME).headers["ETag"]
    assert seeded.get(VOLUME, headers={"If-Match": tag, "If-Unmodified-Since": before}).status_code == 200
    assert seeded.get(VOLUME, headers={"If-None-Match": '"x"', "If-Modified-Since": after}).status_code == 200
    # A picture that is drawn for the request has no such time.
    assert seeded.get(f"{LOG}/slices/1.png", headers={"If-Unmodified-Since": before}).status_code == 200
