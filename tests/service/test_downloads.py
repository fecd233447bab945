"""Downloads as programs meet them: tags and digests of the bytes, ranges, names, and HEAD wherever GET is."""

import hashlib
from base64 import b64encode
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from threading import Event

import pytest
from documented import check_documented

from sawmill_service import digests

LOG, FOUND = "/v1/reconstructions/example", "/v1/calibrations/example"
FILES = {
    f"{LOG}/slices/1.png": "inline",
    f"{LOG}/slices/1.npy": "attachment",
    f"{LOG}/volume.h5": "attachment",
    f"{LOG}/thumbnail.png": "inline",
    f"{FOUND}/result.h5": "attachment",
    "/v1/phantoms/l-shape/drawing.svg": "inline",
    "/v1/scans/example/preview": "inline",
}
# Of a path's parameters.
ANY = defaultdict(lambda: "example", index="0")
# Differs from answer to answer, or is of the way alone.
OWN = {"x-request-id", "date"}


@pytest.mark.parametrize("path", FILES)
def test_a_download_is_known_by_its_bytes(seeded, path):
    whole = seeded.get(path)
    digest = hashlib.sha256(whole.content).digest()
    headers = whole.headers
    assert headers["ETag"] == f'"{digest.hex()}"'
    assert headers["Repr-Digest"] == f"sha-256=:{b64encode(digest).decode()}:"
    assert (headers["Accept-Ranges"], headers["Cache-Control"]) == ("bytes", "private, no-cache")
    assert int(headers["Content-Length"]) == len(whole.content)
    assert headers["Content-Disposition"].startswith(f'{FILES[path]}; filename="')
    assert "example" in headers["Content-Disposition"] or "l-shape" in headers["Content-Disposition"]

    held = seeded.get(path, headers={"If-None-Match": headers["ETag"]})
    assert (held.status_code, held.content, held.headers["ETag"]) == (304, b"", headers["ETag"])

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


def test_the_contract_is_sent_once_to_who_holds_it(seeded):
    whole = seeded.get("/openapi.json")
    assert whole.headers["ETag"] == f'"{hashlib.sha256(whole.content).hexdigest()}"'
    assert whole.headers["Content-Type"] == "application/json"
    assert whole.headers["Content-Disposition"] == 'inline; filename="openapi.json"'
    held = seeded.get("/openapi.json", headers={"If-None-Match": whole.headers["ETag"]})
    assert (held.status_code, held.content) == (304, b"")


def test_the_audit_is_sent_again_when_there_is_a_new_entry(seeded):
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


def test_a_picture_is_drawn_once_for_head_and_get(seeded, monkeypatch):
    path = f"{LOG}/slices/2.png"
    head = seeded.request("HEAD", path)
    monkeypatch.setattr("sawmill_worker.pictures.images.image_png", None)
    assert seeded.get(path).headers["ETag"] == head.headers["ETag"]


def test_the_digest_of_a_large_file_is_kept_beside_it_and_of_that_file_alone(seeded, store, monkeypatch):
    monkeypatch.setattr("sawmill_service.digests._NOTED_FROM_BYTES", 1)
    first = seeded.get(f"{LOG}/volume.h5").headers["ETag"]
    path = store.files.volume("example")
    note = path.with_name(f".{path.name}.sha256")
    assert note.read_text().startswith(first.strip('"'))
    path.write_bytes(b"another one")
    assert seeded.get(f"{LOG}/volume.h5").headers["ETag"] == f'"{hashlib.sha256(b"another one").hexdigest()}"'


def test_small_files_do_not_wait_for_the_digest_of_a_large_one(tmp_path, monkeypatch):
    monkeypatch.setattr("sawmill_service.digests._NOTED_FROM_BYTES", 10)
    small, large = tmp_path / "small", tmp_path / "large"
    small.write_bytes(b"small")
    large.write_bytes(bytes(10))
    computed, go_on = digests._computed, Event()

    def slowly(path):
        assert path == small or go_on.wait(30)
        return computed(path)

    monkeypatch.setattr(digests, "_computed", slowly)
    known = digests.Digests()
    with ThreadPoolExecutor(2) as pool:
        both = [pool.submit(known.of_file, large, large.stat()) for _ in range(2)]
        assert known.of_file(small, small.stat()) == hashlib.sha256(b"small").digest()
        assert not any(each.done() for each in both)
        go_on.set()
        assert {each.result() for each in both} == {hashlib.sha256(bytes(10)).digest()}


def test_head_has_the_headers_of_get_wherever_get_is(seeded):
    for path, operations in seeded.app.openapi()["paths"].items():
        if "get" not in operations:
            continue
        address = path.format_map(ANY)
        head = seeded.request("HEAD", address, headers={"Range": "bytes=0-1"}, timeout=20)
        assert head.content == b"", path
        if path == "/v1/events":
            assert (head.status_code, head.headers["Content-Type"]) == (200, "text/event-stream; charset=utf-8")
            continue
        got = seeded.get(address, timeout=20)
        assert head.status_code == got.status_code, path
        expected = {name: value for name, value in got.headers.items() if name not in OWN}
        if path != "/metrics":  # counts these requests
            assert {name: value for name, value in head.headers.items() if name not in OWN} == expected, path
