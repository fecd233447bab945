"""What a body may be, how slowly it may come, what is refused before a byte is read, and uploads in parts."""

import asyncio
import gzip
import hashlib
import socket
import threading
from base64 import b64encode
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from json import dumps

import numpy as np
import pytest
import uvicorn
from asgi import refusal
from documented import check_documented
from live_service import write_lock
from results import SCANNER_SPEC as SCANNER

from sawmill_contracts.plans import PlanRequest
from sawmill_platform.contracts.keys import KeyRequest, Scope
from sawmill_platform.files.upload_stream import STEP_BYTES
from sawmill_platform.uploads.upload_store import Uploads
from sawmill_service.app import create_app
from sawmill_store.store import Store

SCANS = "/v1/scans?scanner_id=example&data=counts"
PICTURES = "/v1/phantoms/pictures?name=ell&width_mm=400"


def digest(content: bytes, name: str = "sha256") -> str:
    return f"sha-{name[3:]}=:{b64encode(hashlib.new(name, content).digest()).decode()}:"


def incoming(store: Store) -> list[str]:
    return [path.name for path in (store.files.folder / "incoming").iterdir()]


async def untouchable():
    raise AssertionError("a byte of the body was asked for")
    yield b""


def test_what_the_head_tells_is_refused_before_a_byte_is_read(seeded, store):
    media = ("text/html; charset=utf-8", "multipart/form-data; boundary=x", "application/json")
    for path, headers, status, code in (
        (SCANS.replace("example", "nowhere"), {}, 404, "scanner-not-found"),
        *((SCANS, {"Content-Type": each}, 415, "unsupported-media-type") for each in media),
        *(
            (path, {"Content-Type": "text/html"}, 415, "unsupported-media-type")
            for path in ("/v1/inspections", PICTURES)
        ),
        (SCANS, {"Content-Encoding": "br"}, 415, "unsupported-encoding"),
        *((SCANS, {"Content-Digest": each}, 400, "bad-digest") for each in ("sha-256=:bm90IHNvIGxvbmc=:", "what?")),
    ):
        answer = seeded.post(path, content=untouchable(), headers=headers)
        assert (*refusal(answer), incoming(store)) == (status, code, []), (path, headers)
    unknown, too_large = ("POST /v1/scanz", "POST /nothing"), ("PUT /v1/scanners/example", "POST /v1/scanners")
    wrong = ("PATCH /v1/scans", "PUT /v1/phantoms/pictures", "POST /v1/uploads/example", "POST /static/console.js")
    for asked, *expected in (
        *((each, 404, "unknown-path", False) for each in unknown),
        *((each, 405, "method-not-allowed", True) for each in (*wrong, "DELETE /v1/phantoms/pictures")),
        *((each, 413, "body-too-large", False) for each in too_large),
    ):
        answer = seeded.request(*asked.split(), content=untouchable(), headers={"Content-Length": str(10**9)})
        assert [*refusal(answer), "Allow" in answer.headers] == expected, asked


@pytest.mark.parametrize(
    ("limits", "status", "code"),
    [({"disk_reserve_bytes": 2**62}, 507, "storage-full"), ({"max_queued_jobs": 1}, 429, "queue-full")],
)
def test_what_there_is_no_room_for_is_refused_before_a_byte_is_read(seeded, settings, store, limits, status, code):
    store.plans.accept(PlanRequest(scanner_id="example"), given={"phantom_id": "l-shape"})
    full = Store(store.settings.model_copy(update=limits))
    seeded.app = create_app(settings, full, print)
    for path in (SCANS, "/v1/inspections", PICTURES):
        assert refusal(seeded.post(path, content=untouchable())) == (status, code), path
    full.close()


def test_a_database_that_was_found_locked_is_answered_before_a_byte_is_read(seeded, store):
    with write_lock(store.files.folder / "sawmill.db"):
        for path in (SCANS, "/v1/inspections", PICTURES):
            assert seeded.post(path, content=b"scan").status_code == 503
            assert refusal(seeded.post(path, content=untouchable())) == (503, "storage-unavailable")
    assert incoming(store) == []


def test_a_page_or_a_form_is_not_stored_nor_a_file_without_the_ends_of_its_lines(seeded, store):
    form = b"--x1\r\nContent-Disposition: form-data; name=file\r\n\r\n"
    page, packed = b"\xef\xbb\xbf <!doctype html>" + bytes(2000), {"Content-Encoding": "gzip"}
    cut = b"".join(gzip.compress(page[begin : begin + 1]) for begin in range(20)) + gzip.compress(page[20:])
    plain = (b"\n <!DOCTYPE html><p>", b"<HTML>", form)
    for content, headers in (
        *((each, {}) for each in plain),
        *((gzip.compress(each), packed) for each in plain),
        (cut, packed),
    ):
        assert refusal(seeded.post(SCANS, content=content, headers=headers)) == (415, "unsupported-media-type")
    assert incoming(store) == []
    for content, status in ((bytes(5000), 415), (bytes(5000) + b"\n", 202), (b"short", 202)):
        answer = seeded.post(SCANS, content=content, headers={"Content-Type": "application/x-www-form-urlencoded"})
        assert answer.status_code == status
        assert ("--data-binary @FILE" in answer.text) == (status == 415)
        assert incoming(store) == []


def test_a_digest_is_checked(seeded, store):
    for name in ("sha256", "sha512"):
        good = seeded.post(
            SCANS, content=b"scan", headers={"Content-Digest": f"unixsum=:AA==:, {digest(b'scan', name)}"}
        )
        assert good.status_code == 202
        bad = seeded.post(SCANS, content=b"scab", headers={"Content-Digest": digest(b"scan", name)})
        assert refusal(bad) == (400, "digest-mismatch")
        lines = [("Content-Digest", "unixsum=:AA==:"), ("Content-Digest", digest(b"scan", name))]
        assert seeded.post(SCANS, content=b"scab", headers=lines).json()["code"] == "digest-mismatch"
        assert incoming(store) == []


def test_a_body_of_unknown_length_takes_no_room_that_an_upload_was_promised(seeded, settings, store, full_disk):
    seeded.app = create_app(settings.model_copy(update={"max_upload_bytes": 4 * STEP_BYTES}), store, print)
    assert seeded.post("/v1/uploads", json={"size_bytes": 90_000}).status_code == 201
    left = store.settings.disk_reserve_bytes + store.uploads.promised_bytes()
    full_disk(left + 10_000)

    async def body():
        yield bytes(STEP_BYTES)
        full_disk(left - 1)
        yield bytes(STEP_BYTES)
        raise AssertionError("more was asked for")

    assert (refusal(seeded.post(SCANS, content=body())), incoming(store)) == ((507, "storage-full"), [])


def test_a_packed_body_is_unpacked_unless_it_is_a_bomb_or_badly_packed(seeded, store, settings):
    packed, empty = (gzip.compress(content, mtime=0) for content in (b"scan", b""))
    for name, sent, *expected in (
        ("too large", gzip.compress(bytes(100_001), mtime=0), 413, "upload-too-large"),
        ("cut short", packed[:-1], 400, "bad-encoding"),
        ("no gzip", b"no gzip", 400, "bad-encoding"),
        ("empty members, of which each costs time", empty * 200, 400, "bad-encoding"),
        ("an empty file", empty, 422, "empty-body"),
        ("a member after zeros", packed + bytes(9) + packed, 400, "bad-encoding"),
        ("garbage", packed + b"more", 400, "bad-encoding"),
        ("zeros before", bytes(9) + packed, 400, "bad-encoding"),
    ):
        answer = seeded.post(SCANS, content=sent, headers={"Content-Encoding": "gzip"})
        assert [*refusal(answer), incoming(store)] == [*expected, []], name
    content = np.random.default_rng(2).bytes(40_000)
    small, packed = content[:700], gzip.compress(content[:30_000]) + gzip.compress(content[30_000:])

    async def body(sent, pieces):
        for begin in range(0, len(sent), step := -(-len(sent) // pieces)):
            yield sent[begin : begin + step]

    plain, zeros = {"Content-Encoding": "gzip"}, gzip.compress(small[:300]) + gzip.compress(small[300:]) + bytes(1000)
    digested = plain | {"Content-Digest": digest(packed)}
    cut = ((body(zeros, pieces), small, plain) for pieces in (1, 7, 600))
    for sent, whole, headers in ((packed, content, digested), *cut):
        scan = seeded.post(SCANS, content=sent, headers=headers).json()
        assert (scan["size_bytes"], scan["sha256"]) == (len(whole), hashlib.sha256(whole).hexdigest())
    seeded.app = create_app(settings.model_copy(update={"max_upload_bytes": 2**30}), store, print)
    answer = seeded.post(SCANS, content=gzip.compress(bytes(2**26)), headers={"Content-Encoding": "gzip"})
    assert (*refusal(answer), incoming(store)) == (413, "packed-too-well", [])


def test_the_digest_of_any_other_body_is_checked_before_anything_is_done(seeded, store):
    body, json = str.encode(dumps(SCANNER)), {"Content-Type": "application/json"}
    # Damaged so that it is JSON no more, and so that it is another scanner: neither is answered as if it was meant.
    for damaged in (body[:-1] + b"?", body.replace(b"Line 2", b"Line 8")):
        answer = seeded.post("/v1/scanners", content=damaged, headers=json | {"Content-Digest": digest(body)})
        assert refusal(answer) == (400, "digest-mismatch")
        check_documented(answer)
    malformed = seeded.post("/v1/scanners", content=untouchable(), headers=json | {"Content-Digest": "sha-256=5"})
    assert (*refusal(malformed), len(store.scanners.page().items)) == (400, "bad-digest", 2)
    for good in (digest(body), f'unixsum=:AA==:;by="a,b", {digest(body, "sha512")}', "md5=:AAAA:", ""):
        answer = seeded.post("/v1/scanners", content=body, headers=json | {"Content-Digest": good})
        assert answer.status_code == 201, (good, answer.text)
    # Of a body that no route reads, and of an empty one.
    path, sent = answer.headers["Location"], b"some bytes"
    for body in (sent, b""):
        answer = seeded.request("DELETE", path, content=body, headers={"Content-Digest": digest(b"others")})
        assert refusal(answer) == (400, "digest-mismatch")
        check_documented(answer)
    assert seeded.get(path).status_code == 200
    right = seeded.request("DELETE", path, content=sent, headers={"Content-Digest": digest(sent)})
    assert (right.status_code, seeded.get(path).status_code) == (204, 404)
    for path in ("/v1/jobs/example/cancel", SCANS + "&inspection_id=example"):
        assert refusal(seeded.post(path, headers={"Content-Digest": digest(b"other")})) == (400, "digest-mismatch")
        assert seeded.post(path, headers={"Content-Digest": digest(b"")}).status_code == 202


async def standing_still() -> AsyncIterator[bytes]:
    yield b"half"
    await asyncio.Event().wait()


async def byte_by_byte() -> AsyncIterator[bytes]:
    for _ in range(20):
        await asyncio.sleep(0.01)
        yield b"a"


@pytest.mark.usefixtures("seeded")
def test_a_body_that_comes_too_slowly_is_refused_and_a_slow_line_is_fast_enough(limited, store):
    for bounds, body, reason in (
        ({"client_silence_s": 0.3}, standing_still, "nothing came for 0.3 s"),
        ({"body_grace_s": 0.05, "min_client_bytes_per_s": 1e6}, byte_by_byte, "bytes came in"),
    ):
        answer = limited(**bounds).post(SCANS, content=body())
        assert (*refusal(answer), answer.headers["Connection"]) == (408, "slow-body", "close")
        assert reason in answer.json()["detail"]
        assert incoming(store) == []
    for grace_s, least in ((600.0, 1e6), (0.0, 1e-3)):
        client = limited(body_grace_s=grace_s, min_client_bytes_per_s=least)
        assert client.post(SCANS, content=byte_by_byte()).status_code == 202


@pytest.mark.usefixtures("seeded")
def test_half_bodies_over_sockets_leave_nothing_without_a_proxy(limited, store):
    app = limited(client_silence_s=0.3).app
    head = b"POST /v1/scans?scanner_id=example&data=counts HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 100\r\n\r\n"
    server = uvicorn.Server(uvicorn.Config(app, http="h11", ws="none", lifespan="off", log_config=None))
    with socket.create_server(("127.0.0.1", 0)) as listening:
        thread = threading.Thread(target=server.run, args=([listening],))
        thread.start()
        try:
            clients = [socket.create_connection(listening.getsockname(), timeout=60) for _ in range(20)]
            for client in clients:
                client.sendall(head + b"half")
            answers = []
            for client in clients:
                with client, client.makefile("rb") as answer:
                    answers.append(answer.read())
        finally:
            server.should_exit = True
            thread.join(60)
    assert ([b'"code":"slow-body"' in answer for answer in answers], incoming(store)) == ([True] * 20, [])


CONTENT = bytes(range(256)) * 40
WITH_UPLOAD = f"{SCANS}&upload_id="


def begin(seeded, **given):
    answer = seeded.post("/v1/uploads", json={"size_bytes": len(CONTENT), **given})
    assert answer.status_code == 201, answer.text
    return answer.headers["Location"]


def send_part(seeded, path, offset, content, **headers):
    given = {"Upload-Offset": str(offset), "Content-Type": "application/partial-upload", **headers}
    return seeded.request("PATCH", path, content=content, headers=given)


def test_a_file_in_parts_becomes_a_scan_once(seeded, store):
    path = begin(seeded, name="mill.h5", sha256=hashlib.sha256(CONTENT).hexdigest())
    first = send_part(seeded, path, 0, CONTENT[:5000])
    assert (first.json()["offset_bytes"], first.json()["state"]) == (5000, "receiving")
    head = seeded.request("HEAD", path)
    given = [head.headers[f"Upload-{name}"] for name in ("Offset", "Length", "Complete")]
    assert (head.status_code, given, head.headers["Cache-Control"]) == (200, ["5000", "10240", "?0"], "no-store")
    wrong = send_part(seeded, path, 4999, CONTENT[4999:])
    assert (*refusal(wrong), wrong.headers["Upload-Offset"]) == (409, "wrong-offset", "5000")
    assert send_part(seeded, path, 5000, CONTENT).json()["code"] == "upload-too-long"
    assert send_part(seeded, path, 5000, CONTENT[5000:]).headers["Upload-Complete"] == "?1"
    upload_id = path.rpartition("/")[2]
    assert seeded.post(f"{WITH_UPLOAD}{upload_id}", content=b"x").json()["code"] == "two-files"
    assert seeded.post(f"{WITH_UPLOAD}{upload_id}&inspection_id=example").json()["code"] == "two-files"
    scan = seeded.post(f"{WITH_UPLOAD}{upload_id}").json()
    assert (store.files.folder / "uploads/scans" / scan["id"] / "original").read_bytes() == CONTENT
    assert seeded.get(path).json()["used_by"] == f"/v1/scans/{scan['id']}"
    assert refusal(seeded.post(f"{WITH_UPLOAD}{upload_id}")) == (409, "upload-used")
    assert (send_part(seeded, path, 10240, b"").json()["code"], seeded.delete(path).status_code) == ("upload-used", 204)
    assert seeded.request("HEAD", path).status_code == 404


def test_other_files_come_in_parts_too_and_need_the_scope_to_submit(seeded, store):
    for path in ("/v1/inspections?", "/v1/phantoms/pictures?name=ell&width_mm=400&"):
        upload = begin(seeded)
        send_part(seeded, upload, 0, CONTENT)
        made = seeded.post(f"{path}upload_id={upload.rpartition('/')[2]}")
        assert (made.status_code, seeded.get(upload).json()["used_by"]) == (202, made.headers["Location"])
    for scope, status in ((Scope.READ, 403), (Scope.SUBMIT, 201)):
        seeded.headers["Authorization"] = f"Bearer {store.keys.create(KeyRequest(name='own', scope=scope)).secret}"
        made = seeded.post("/v1/uploads", json={"size_bytes": 3})
        assert made.status_code == status
    assert send_part(seeded, made.headers["Location"], 0, b"abc").is_success


def test_a_file_of_another_digest_and_a_page_are_not_kept(seeded):
    path = begin(seeded, sha256="0" * 64)
    assert refusal(send_part(seeded, path, 0, CONTENT)) == (400, "digest-mismatch")
    assert seeded.get(path).status_code == 404
    page = begin(seeded)
    assert refusal(send_part(seeded, page, 0, b"<html>" + CONTENT[6:])) == (415, "unsupported-media-type")
    assert send_part(seeded, page, 0, b"x", **{"Content-Encoding": "gzip"}).json()["code"] == "unsupported-encoding"
    path, false = begin(seeded), {"Content-Digest": f"sha-256=:{'A' * 43}=:"}
    assert send_part(seeded, path, 0, CONTENT, **false).json()["code"] == "digest-mismatch"
    assert seeded.get(path).json()["offset_bytes"] == 0
    path, page = begin(seeded), b"<html>" + CONTENT[6:]
    assert send_part(seeded, path, 0, page[:1]).status_code == 200
    assert send_part(seeded, path, 1, page[1:]).status_code == 200
    assert refusal(seeded.post(f"{WITH_UPLOAD}{path.rpartition('/')[2]}")) == (415, "unsupported-media-type")


def test_a_malformed_head_of_a_part_is_refused_and_one_that_says_it_is_the_last_and_is_not(seeded):
    path, seven = begin(seeded), ("Upload-Offset", "7")
    send_part(seeded, path, 0, CONTENT[:7])
    for headers, sentence in (
        ([], "Upload-Offset is missing"),
        ([("Upload-Offset", "")], "Upload-Offset must be a count of bytes"),
        ([("Upload-Offset", "7.0")], "as in 1048576, not '7.0'"),
        *(([("Upload-Offset", wrong)], f"not '{wrong}'") for wrong in ("+7", "-1", "7;")),
        ([seven, seven], "not '7, 7'"),
        ([("Upload-Offset", "1" * 16)], "Upload-Offset must be"),
        ([seven, ("Upload-Complete", "1")], "Upload-Complete must be ?1 or ?0, not '1'"),
        ([seven, ("Upload-Complete", "true")], "Upload-Complete must be"),
        ([seven, ("Upload-Length", "many")], "Upload-Length must be"),
    ):
        refused = seeded.request("PATCH", path, content=CONTENT[7:], headers=headers)
        assert refusal(refused) == (400, "bad-upload-header"), refused.text
        assert sentence in refused.json()["detail"]
        assert seeded.get(path).json()["offset_bytes"] == 7
    assert send_part(seeded, path, "7;from=disk", CONTENT[7:]).status_code == 200, "unknown parameters mean nothing"
    path = begin(seeded)
    for content, kept in ((CONTENT[:5], 0), (unannounced(CONTENT[:5]), 5)):
        refused = send_part(seeded, path, 0, content, **{"Upload-Complete": "?1"})
        assert refusal(refused) == (400, "inconsistent-length"), refused.text
        assert f"{len(CONTENT) - 5} bytes are missing" in refused.json()["detail"]
        assert seeded.get(path).json()["offset_bytes"] == kept
    assert refusal(send_part(seeded, path, 5, CONTENT[5:], **{"Upload-Length": "5"})) == (400, "inconsistent-length")
    assert send_part(seeded, path, 5, CONTENT[5:9], **{"Upload-Complete": "?0"}).status_code == 200
    right = {"Upload-Complete": "?1", "Upload-Length": str(len(CONTENT))}
    assert send_part(seeded, path, 9, CONTENT[9:], **right).headers["Upload-Complete"] == "?1"


async def unannounced(content):
    yield content


def test_a_busy_upload_and_a_locked_database_are_answered_before_a_part_is_read(seeded, store):
    path = begin(seeded)
    part = store.uploads.begin_part(path.rpartition("/")[2], 0)
    busy = send_part(seeded, path, 0, CONTENT)
    part.close()
    assert (*refusal(busy), busy.headers["Retry-After"]) == (409, "upload-busy", "5")
    check_documented(busy)
    with write_lock(store.files.folder / "sawmill.db"):
        assert send_part(seeded, path, 0, CONTENT).status_code == 503
        assert send_part(seeded, path, 0, untouchable()).status_code == 503


def test_the_sum_of_a_large_file_keeps_no_other_part_waiting(seeded, store):
    """As many files as there are threads for sums are being summed up."""
    summing, go_on = threading.Semaphore(0), threading.Event()

    class SlowSum:
        def __init__(self, part):
            self.part = part

        def __getattr__(self, name):
            return getattr(self.part, name)

        def complete(self):
            summing.release()
            assert go_on.wait(60)
            self.part.complete()

    class LargeUploads(Uploads):
        def begin_part(self, *given, **options):
            return SlowSum(super().begin_part(*given, **options))

    store.uploads = LargeUploads(store.database, store.files, 0)
    paths = [begin(seeded) for _ in range(3)]
    with ThreadPoolExecutor(2) as pool:
        whole = [pool.submit(send_part, seeded, path, 0, CONTENT) for path in paths[:2]]
        assert all(summing.acquire(timeout=60) for _ in whole)
        assert send_part(seeded, paths[2], 0, CONTENT[:9]).json()["offset_bytes"] == 9
        go_on.set()
        assert [answer.result().headers["Upload-Complete"] for answer in whole] == ["?1", "?1"]


def test_an_upload_belongs_to_the_key_that_began_it(seeded, store):
    secrets = [store.keys.create(KeyRequest(name=name, scope=Scope.SUBMIT)).secret for name in ("own", "another")]
    admin = store.keys.create(KeyRequest(name="admin", scope=Scope.ADMIN)).secret
    own, another, admin = ({"Authorization": f"Bearer {secret}"} for secret in (*secrets, admin))
    seeded.headers |= own
    paths = [begin(seeded) for _ in range(2)]
    send_part(seeded, paths[0], 0, CONTENT)
    use = f"{WITH_UPLOAD}{paths[0].rpartition('/')[2]}"
    for stranger in (another, admin):
        seeded.headers |= stranger
        refused = [seeded.get(paths[0]), send_part(seeded, paths[1], 0, CONTENT), seeded.post(use)]
        assert [(answer.status_code, answer.json()["code"]) for answer in refused] == [(404, "upload-not-found")] * 3
        assert seeded.request("HEAD", paths[0]).status_code == 404
    seeded.headers |= another
    assert seeded.delete(paths[1]).json()["code"] == "upload-not-found"
    seeded.headers |= admin
    assert seeded.delete(paths[1]).status_code == 204
    seeded.headers |= own
    assert (seeded.get(paths[1]).status_code, seeded.post(use).status_code) == (404, 202)
