"""Files become scans: sent, inspected, listed and deleted."""

import asyncio
import io

import numpy as np
import pytest
from asgi import refusal, scope_of
from PIL import Image

from sawmill_contracts import kinds
from sawmill_service.app import create_app
from sawmill_store.store import Store

UPLOAD = "/v1/scans?scanner_id=example&data=counts"


def incoming(store: Store) -> list[str]:
    return [path.name for path in (store.files.folder / "incoming").iterdir()]


def left_by_uploads(store: Store) -> list[str]:
    names = [path.name for path in (store.files.folder / "uploads/scans").iterdir()]
    return [*incoming(store), *(name for name in names if not name.startswith("example"))]


def test_an_upload_is_kept_as_it_came_and_read_by_a_job_which_is_woken_after_the_commit(seeded, store, woken, settings):
    content = np.random.default_rng(1).bytes(5000)
    answer = seeded.post(UPLOAD + "&name=morning&phantom_id=l-shape&phantom_rows=0:2", content=content)
    assert (answer.status_code, answer.headers["Retry-After"]) == (202, "1")
    scan = seeded.get(answer.headers["Location"]).json()
    assert (scan["state"], scan["name"], scan["size_bytes"], woken) == ("ingesting", "morning", 5000, [scan["job_id"]])
    assert (store.files.folder / "uploads/scans" / scan["id"] / "original").read_bytes() == content
    prepared = {"air": "background", "rings": "sorting", "align_rows": "profile"}
    query = "".join(f"&{name}={value}" for name, value in prepared.items())
    scan = seeded.get(seeded.post(UPLOAD + query, content=b"x").headers["Location"]).json()
    assert {name: scan[name] for name in (*prepared, "faulty_cells")} == prepared | {"faulty_cells": "auto"}
    seen = []
    seeded.app = create_app(settings, store, lambda job_id: seen.append(store.jobs.get(job_id).state))
    assert (seeded.post(UPLOAD, content=b"x").status_code, seen) == (202, ["queued"])


def test_an_undeclared_size_above_the_limit_and_a_false_one_are_refused(seeded, store, settings):
    sent = 0

    async def endless():
        nonlocal sent
        while True:
            sent += 10_000
            yield bytes(10_000)

    assert refusal(seeded.post(UPLOAD, content=endless())) == (413, "body-too-large")
    assert sent <= settings.max_upload_bytes + 10_000
    for declared in ("3", "4000", "-1", "many"):
        answer = seeded.post(UPLOAD, content=b"1234", headers={"Content-Length": declared})
        assert refusal(answer) == (400, "bad-length"), declared
    assert left_by_uploads(store) == []


def test_a_client_that_goes_leaves_nothing_and_the_mean_of_rows_is_never_sent_as_counts(seeded, store, woken):
    messages = iter([{"type": "http.request", "body": b"half", "more_body": True}, {"type": "http.disconnect"}])
    sent = []

    async def receive():
        return next(messages)

    async def send(message):
        sent.append(message)

    asyncio.run(seeded.app(scope_of(UPLOAD, "POST"), receive, send))
    assert (sent, left_by_uploads(store), woken) == ([], [], [])
    mean = "/v1/scans?scanner_id=example&averaged_rows=1000&data="
    refused = seeded.post(mean + "counts", content=b"x")
    assert (*refusal(refused), woken) == (422, "invalid-request", [])
    (error,) = refused.json()["errors"]
    assert "-ln of a mean is not the mean of -ln, so take -ln((counts - dark) / (flat - dark))" in error["message"]
    assert left_by_uploads(store) == []
    answer = seeded.post(mean + "line-integrals&angles_deg=9:18", content=b"x")
    assert seeded.get(answer.headers["Location"]).json()["averaged_rows"] == 1000
    assert seeded.get("/v1/scans/example").json()["averaged_rows"] is None


def test_a_sinogram_of_each_row_is_drawn_and_scans_are_listed_and_deleted_unless_a_job_needs_them(seeded, store):
    first = seeded.get("/v1/scans/example/sinogram.png?row=1")
    assert Image.open(io.BytesIO(first.content)).format == "PNG"
    other = seeded.get("/v1/scans/example/sinogram.png?row=2", headers={"If-None-Match": first.headers["ETag"]})
    assert other.status_code == 200
    assert other.content != first.content
    assert seeded.get("/v1/scans/example/preview").content == other.content, "the middle row"
    for row in ("4", "-1", "one", "99999999999999999999999"):
        answer = seeded.get(f"/v1/scans/example/sinogram.png?row={row}")
        assert (answer.status_code, row in answer.json()["detail"]) == (422, True)
    path = seeded.post(UPLOAD, content=b"x").headers["Location"]
    assert len(seeded.get("/v1/scans").json()["items"]) == 3
    assert len(seeded.get("/v1/scans?state=ready").json()["items"]) == 2
    assert seeded.get("/v1/scans?scanner_id=example-spare").json()["items"] == []
    assert seeded.delete("/v1/scans/example-spare").status_code == 204
    assert seeded.get("/v1/scans/example-spare").status_code == 404
    assert not (store.files.folder / "scans/example-spare").exists()
    assert seeded.delete(path).json()["code"] == "scan-in-use"
    assert refusal(seeded.get(f"{path}/preview")) == (409, "scan-ingesting")


CONTENT = np.random.default_rng(5).bytes(5000)


@pytest.fixture
def inspection(seeded):
    return seeded.post("/v1/inspections?name=morning.npz", content=CONTENT).json()


def test_a_file_is_inspected_by_a_job_and_what_is_missing_has_the_field_that_gives_it(
    seeded, inspection, worker, store, woken
):
    worker.finish_inspection()
    found = seeded.get(f"/v1/inspections/{inspection['id']}").json()
    assert (found["state"], found["result"]["verdict"]) == ("succeeded", "incomplete")
    assert [part["field"] for part in found["result"]["missing"]] == ["data"]
    answer = seeded.post("/v1/inspections?name=morning.npz&dataset=entry", content=CONTENT)
    assert (answer.status_code, answer.headers["Retry-After"]) == (202, "1")
    found = seeded.get(answer.headers["Location"]).json()
    assert found == answer.json()
    assert woken == [inspection["job_id"], found["job_id"]]
    assert (found["state"], found["result"]) == ("queued", None)
    assert found["links"]["job"] == f"/v1/jobs/{found['job_id']}"
    options = found["options"]
    assert (options["name"], options["dataset"], options["size_bytes"]) == ("morning.npz", "entry", len(CONTENT))
    assert store.files.upload(kinds.INSPECT, found["id"]).read_bytes() == CONTENT


def test_an_inspected_file_becomes_scans_or_is_inspected_again_without_being_sent_again(seeded, store, inspection):
    scans = [seeded.post(f"{UPLOAD}&inspection_id={inspection['id']}").json() for _ in range(2)]
    for scan in scans:
        assert scan["state"] == "ingesting"
        assert scan["size_bytes"] == len(CONTENT)
        assert scan["sha256"] == inspection["options"]["sha256"]
        assert store.files.upload(kinds.INGEST, scan["id"]).read_bytes() == CONTENT
    # One file with three names: a scan costs no second room on the disk.
    assert (store.files.upload(kinds.INGEST, scans[0]["id"]).stat().st_nlink, incoming(store)) == (3, [])
    again = seeded.post(f"/v1/inspections?inspection_id={inspection['id']}&dataset=other").json()
    assert (again["options"]["dataset"], again["options"]["size_bytes"]) == ("other", len(CONTENT))
    assert store.files.upload(kinds.INSPECT, again["id"]).read_bytes() == CONTENT


def test_a_deleted_inspection_leaves_the_scan_its_file_and_a_removed_file_must_be_sent_again(
    seeded, store, inspection, worker
):
    path = f"/v1/inspections/{inspection['id']}"
    assert seeded.delete(path).json()["code"] == "inspection-in-use"
    worker.finish_inspection()
    scan = seeded.post(f"{UPLOAD}&inspection_id={inspection['id']}").json()
    assert (seeded.delete(path).status_code, seeded.get(path).json()["code"]) == (204, "inspection-not-found")
    assert not store.files.upload(kinds.INSPECT, inspection["id"]).exists()
    assert store.files.upload(kinds.INGEST, scan["id"]).read_bytes() == CONTENT
    assert seeded.get("/v1/audit").json()["items"][0]["action"] == "inspection-deleted"
    store.files.remove_upload(kinds.INSPECT, "example")
    answer = seeded.post(f"{UPLOAD}&inspection_id=example")
    assert refusal(answer) == (409, "inspection-expired")
    assert "send it again" in answer.json()["detail"]
