"""Uploads in parts, without a network; tests/end_to_end/test_broken_uploads.py has one."""

import hashlib

import pytest

from sawmill_worker.contracts.keys import KeyAsk, Scope

CONTENT = bytes(range(256)) * 40
SCANS = "/v1/scans?scanner_id=example&data=counts&upload_id="


def begin(seeded, **given):
    answer = seeded.post("/v1/uploads", json={"size_bytes": len(CONTENT), **given})
    assert answer.status_code == 201, answer.text
    return answer.headers["Location"]


def patch(seeded, path, offset, content, **headers):
    given = {"Upload-Offset": str(offset), "Content-Type": "application/partial-upload", **headers}
    return seeded.request("PATCH", path, content=content, headers=given)


def test_a_file_in_parts_becomes_a_scan_once(seeded, store):
    path = begin(seeded, name="mill.h5", sha256=hashlib.sha256(CONTENT).hexdigest())
    first = patch(seeded, path, 0, CONTENT[:5000])
    assert (first.json()["offset_bytes"], first.json()["state"]) == (5000, "receiving")
    head = seeded.request("HEAD", path)
    given = [head.headers[f"Upload-{name}"] for name in ("Offset", "Length", "Complete")]
    assert (head.status_code, given, head.headers["Cache-Control"]) == (200, ["5000", "10240", "?0"], "no-store")
    wrong = patch(seeded, path, 4999, CONTENT[4999:])
    assert (wrong.status_code, wrong.json()["code"], wrong.headers["Upload-Offset"]) == (409, "wrong-offset", "5000")
    assert patch(seeded, path, 5000, CONTENT).json()["code"] == "upload-too-long"
    assert patch(seeded, path, 5000, CONTENT[5000:]).headers["Upload-Complete"] == "?1"
    upload_id = path.rpartition("/")[2]
    assert seeded.post(f"{SCANS}{upload_id}", content=b"x").json()["code"] == "two-files"
    assert seeded.post(f"{SCANS}{upload_id}&inspection_id=example").json()["code"] == "two-files"
    scan = seeded.post(f"{SCANS}{upload_id}").json()
    assert (store.files.folder / "uploads/scans" / scan["id"] / "original").read_bytes() == CONTENT
    assert seeded.get(path).json()["used_by"] == f"/v1/scans/{scan['id']}"
    again = seeded.post(f"{SCANS}{upload_id}")
    assert (again.status_code, again.json()["code"]) == (409, "upload-used")
    assert patch(seeded, path, 10240, b"").json()["code"] == "upload-used"
    assert seeded.delete(path).status_code == 204
    assert seeded.request("HEAD", path).status_code == 404


@pytest.mark.parametrize("path", ["/v1/inspections?", "/v1/phantoms/pictures?name=ell&width_mm=400&"])
def test_other_files_come_in_parts_too(seeded, path):
    upload = begin(seeded)
    patch(seeded, upload, 0, CONTENT)
    made = seeded.post(f"{path}upload_id={upload.rpartition('/')[2]}")
    assert made.status_code == 202
    assert seeded.get(upload).json()["used_by"] == made.headers["Location"]


def test_a_part_with_a_digest_counts_as_a_whole(seeded):
    path = begin(seeded)
    false = {"Content-Digest": f"sha-256=:{'A' * 43}=:"}
    assert patch(seeded, path, 0, CONTENT, **false).json()["code"] == "digest-mismatch"
    assert seeded.get(path).json()["offset_bytes"] == 0


def test_a_file_of_another_digest_and_a_page_are_not_kept(seeded):
    path = begin(seeded, sha256="0" * 64)
    false = patch(seeded, path, 0, CONTENT)
    assert (false.status_code, false.json()["code"]) == (400, "digest-mismatch")
    assert seeded.get(path).status_code == 404
    page = begin(seeded)
    answer = patch(seeded, page, 0, b"<html>" + CONTENT[6:])
    assert (answer.status_code, answer.json()["code"]) == (415, "unsupported-media-type")
    assert patch(seeded, page, 0, b"x", **{"Content-Encoding": "gzip"}).json()["code"] == "unsupported-encoding"


@pytest.mark.parametrize(
    ("given", "status", "code"),
    [
        ({"size_bytes": 100_001}, 413, "upload-too-large"),
        ({"size_bytes": 0}, 422, "invalid-request"),
        ({"size_bytes": 3, "sha256": "abc"}, 422, "invalid-request"),
    ],
)
def test_what_cannot_become_a_file_is_refused_at_its_beginning(seeded, given, status, code):
    answer = seeded.post("/v1/uploads", json=given)
    assert (answer.status_code, answer.json()["code"]) == (status, code)


def test_uploads_need_the_scope_to_submit(seeded, store):
    for scope, status in ((Scope.READ, 403), (Scope.SUBMIT, 201)):
        seeded.headers["Authorization"] = f"Bearer {store.keys.create(KeyAsk(name='own', scope=scope)).secret}"
        assert seeded.post("/v1/uploads", json={"size_bytes": 3}).status_code == status
    assert seeded.request("PATCH", "/v1/uploads/example", content=b"abc").status_code == 200
