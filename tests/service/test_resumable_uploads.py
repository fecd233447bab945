"""Uploads in parts, without a network; tests/end_to_end/test_broken_uploads.py has one."""

import hashlib
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from asgi import refusal
from documented import check_documented
from write_lock import write_lock

from sawmill_platform.contracts.keys import KeyAsk, Scope
from sawmill_platform.uploads.upload_store import Uploads

CONTENT = bytes(range(256)) * 40
SCANS = "/v1/scans?scanner_id=example&data=counts&upload_id="


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
    assert (wrong.status_code, wrong.json()["code"], wrong.headers["Upload-Offset"]) == (409, "wrong-offset", "5000")
    assert send_part(seeded, path, 5000, CONTENT).json()["code"] == "upload-too-long"
    assert send_part(seeded, path, 5000, CONTENT[5000:]).headers["Upload-Complete"] == "?1"
    upload_id = path.rpartition("/")[2]
    assert seeded.post(f"{SCANS}{upload_id}", content=b"x").json()["code"] == "two-files"
    assert seeded.post(f"{SCANS}{upload_id}&inspection_id=example").json()["code"] == "two-files"
    scan = seeded.post(f"{SCANS}{upload_id}").json()
    assert (store.files.folder / "uploads/scans" / scan["id"] / "original").read_bytes() == CONTENT
    assert seeded.get(path).json()["used_by"] == f"/v1/scans/{scan['id']}"
    assert refusal(seeded.post(f"{SCANS}{upload_id}")) == (409, "upload-used")
    assert (send_part(seeded, path, 10240, b"").json()["code"], seeded.delete(path).status_code) == ("upload-used", 204)
    assert seeded.request("HEAD", path).status_code == 404


@pytest.mark.parametrize("path", ["/v1/inspections?", "/v1/phantoms/pictures?name=ell&width_mm=400&"])
def test_other_files_come_in_parts_too(seeded, path):
    upload = begin(seeded)
    send_part(seeded, upload, 0, CONTENT)
    made = seeded.post(f"{path}upload_id={upload.rpartition('/')[2]}")
    assert (made.status_code, seeded.get(upload).json()["used_by"]) == (202, made.headers["Location"])


def test_a_file_of_another_digest_and_a_page_are_not_kept(seeded):
    path = begin(seeded, sha256="0" * 64)
    assert refusal(send_part(seeded, path, 0, CONTENT)) == (400, "digest-mismatch")
    assert seeded.get(path).status_code == 404
    page = begin(seeded)
    assert refusal(send_part(seeded, page, 0, b"<html>" + CONTENT[6:])) == (415, "unsupported-media-type")
    assert send_part(seeded, page, 0, b"x", **{"Content-Encoding": "gzip"}).json()["code"] == "unsupported-encoding"
    path = begin(seeded)
    false = {"Content-Digest": f"sha-256=:{'A' * 43}=:"}
    assert send_part(seeded, path, 0, CONTENT, **false).json()["code"] == "digest-mismatch"
    assert seeded.get(path).json()["offset_bytes"] == 0
    path = begin(seeded)
    page = b"<html>" + CONTENT[6:]
    assert send_part(seeded, path, 0, page[:1]).status_code == 200
    assert send_part(seeded, path, 1, page[1:]).status_code == 200
    assert refusal(seeded.post(f"{SCANS}{path.rpartition('/')[2]}")) == (415, "unsupported-media-type")


def test_uploads_need_the_scope_to_submit(seeded, store):
    for scope, status in ((Scope.READ, 403), (Scope.SUBMIT, 201)):
        seeded.headers["Authorization"] = f"Bearer {store.keys.create(KeyAsk(name='own', scope=scope)).secret}"
        assert seeded.post("/v1/uploads", json={"size_bytes": 3}).status_code == status
    assert send_part(
        seeded, seeded.post("/v1/uploads", json={"size_bytes": 3}).headers["Location"], 0, b"abc"
    ).is_success


@pytest.mark.parametrize(
    ("headers", "sentence"),
    [
        ([], "Upload-Offset is missing"),
        ([("Upload-Offset", "")], "Upload-Offset must be a count of bytes"),
        ([("Upload-Offset", "7.0")], "as in 1048576, not '7.0'"),
        ([("Upload-Offset", "+7")], "not '+7'"),
        ([("Upload-Offset", "-1")], "not '-1'"),
        ([("Upload-Offset", "7;")], "not '7;'"),
        ([("Upload-Offset", "7"), ("Upload-Offset", "7")], "not '7, 7'"),
        ([("Upload-Offset", "1" * 16)], "Upload-Offset must be"),
        ([("Upload-Offset", "7"), ("Upload-Complete", "1")], "Upload-Complete must be ?1 or ?0, not '1'"),
        ([("Upload-Offset", "7"), ("Upload-Complete", "true")], "Upload-Complete must be"),
        ([("Upload-Offset", "7"), ("Upload-Length", "many")], "Upload-Length must be"),
    ],
    ids=lambda value: value.split(" ", 1)[0] if isinstance(value, str) else str(value)[:60],
)
def test_a_malformed_head_of_a_part_is_refused_with_a_sentence(seeded, headers, sentence):
    path = begin(seeded)
    send_part(seeded, path, 0, CONTENT[:7])
    refused = seeded.request("PATCH", path, content=CONTENT[7:], headers=headers)
    assert (refused.status_code, refused.json()["code"]) == (400, "bad-upload-header"), refused.text
    assert sentence in refused.json()["detail"]
    assert seeded.get(path).json()["offset_bytes"] == 7
    assert send_part(seeded, path, "7;from=disk", CONTENT[7:]).status_code == 200, "unknown parameters mean nothing"


async def unannounced(content):
    yield content


def test_a_part_that_is_no_last_one_may_not_say_so(seeded):
    path = begin(seeded)
    for content, kept in ((CONTENT[:5], 0), (unannounced(CONTENT[:5]), 5)):
        refused = send_part(seeded, path, 0, content, **{"Upload-Complete": "?1"})
        assert (refused.status_code, refused.json()["code"]) == (400, "inconsistent-length"), refused.text
        assert f"{len(CONTENT) - 5} bytes are missing" in refused.json()["detail"]
        assert seeded.get(path).json()["offset_bytes"] == kept
    assert refusal(send_part(seeded, path, 5, CONTENT[5:], **{"Upload-Length": "5"})) == (400, "inconsistent-length")
    assert send_part(seeded, path, 5, CONTENT[5:9], **{"Upload-Complete": "?0"}).status_code == 200
    right = {"Upload-Complete": "?1", "Upload-Length": str(len(CONTENT))}
    assert send_part(seeded, path, 9, CONTENT[9:], **right).headers["Upload-Complete"] == "?1"


def test_a_busy_upload_and_a_locked_database_are_answered_before_a_part_is_read(seeded, store):
    path = begin(seeded)
    part = store.uploads.begin_part(path.rpartition("/")[2], 0)
    busy = send_part(seeded, path, 0, CONTENT)
    part.close()
    assert (busy.status_code, busy.json()["code"], busy.headers["Retry-After"]) == (409, "upload-busy", "5")
    check_documented(busy)
    with write_lock(store.files.folder / "sawmill.db"):
        assert send_part(seeded, path, 0, CONTENT).status_code == 503

        async def untouchable():
            raise AssertionError("a byte of the body was asked for")
            yield b""

        assert send_part(seeded, path, 0, untouchable()).status_code == 503


def test_the_sum_of_a_large_file_keeps_no_other_part_waiting(seeded, store):
    """As many files as there are threads for sums are being summed up."""
    summing, go_on = threading.Semaphore(0), threading.Event()

    class SlowSum:
        """A part whose file takes long to sum up."""

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
    secrets = [store.keys.create(KeyAsk(name=name, scope=Scope.SUBMIT)).secret for name in ("own", "another")]
    admin = store.keys.create(KeyAsk(name="admin", scope=Scope.ADMIN)).secret
    own, another, admin = ({"Authorization": f"Bearer {secret}"} for secret in (*secrets, admin))
    seeded.headers |= own
    paths = [begin(seeded) for _ in range(2)]
    send_part(seeded, paths[0], 0, CONTENT)
    use = f"{SCANS}{paths[0].rpartition('/')[2]}"
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
