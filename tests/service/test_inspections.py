"""A file is inspected before it becomes a scan, and is sent once."""

import numpy as np
import pytest

from sawmill_contracts import kinds
from sawmill_store.store import Store

CONTENT = np.random.default_rng(5).bytes(5000)
AS_SCAN = "/v1/scans?scanner_id=example&data=counts"


def arriving(store: Store) -> list[str]:
    return [path.name for path in (store.files.folder / "incoming").iterdir()]


@pytest.fixture
def inspection(seeded):
    return seeded.post("/v1/inspections?name=morning.npz", content=CONTENT).json()


def test_a_file_is_inspected_by_a_job(seeded, store, woken):
    answer = seeded.post("/v1/inspections?name=morning.npz&dataset=entry", content=CONTENT)
    assert (answer.status_code, answer.headers["Retry-After"]) == (202, "1")
    found = seeded.get(answer.headers["Location"]).json()
    assert (found, woken, found["state"], found["result"]) == (answer.json(), [found["job_id"]], "queued", None)
    assert found["links"]["job"] == f"/v1/jobs/{found['job_id']}"
    options = found["options"]
    assert (options["name"], options["dataset"], options["size_bytes"]) == ("morning.npz", "entry", len(CONTENT))
    assert store.files.upload(kinds.INSPECT, found["id"]).read_bytes() == CONTENT


def test_what_is_missing_has_the_field_that_gives_it(seeded, inspection, worker):
    worker.finish_inspection()
    found = seeded.get(f"/v1/inspections/{inspection['id']}").json()
    assert (found["state"], found["result"]["verdict"]) == ("succeeded", "incomplete")
    assert [part["field"] for part in found["result"]["missing"]] == ["data"]


def test_an_inspected_file_becomes_scans_or_is_inspected_again_without_being_sent_again(seeded, store, inspection):
    scans = [seeded.post(f"{AS_SCAN}&inspection_id={inspection['id']}").json() for _ in range(2)]
    for scan in scans:
        assert (scan["state"], scan["size_bytes"], scan["sha256"]) == (
            "ingesting",
            len(CONTENT),
            inspection["options"]["sha256"],
        )
        assert store.files.upload(kinds.INGEST, scan["id"]).read_bytes() == CONTENT
    # One file with three names: a scan costs no second room on the disk.
    assert (store.files.upload(kinds.INGEST, scans[0]["id"]).stat().st_nlink, arriving(store)) == (3, [])
    again = seeded.post(f"/v1/inspections?inspection_id={inspection['id']}&dataset=other").json()
    assert (again["options"]["dataset"], again["options"]["size_bytes"]) == ("other", len(CONTENT))
    assert store.files.upload(kinds.INSPECT, again["id"]).read_bytes() == CONTENT


def test_a_deleted_inspection_leaves_the_scan_its_file(seeded, store, inspection, worker):
    path = f"/v1/inspections/{inspection['id']}"
    assert seeded.delete(path).json()["code"] == "inspection-in-use"
    worker.finish_inspection()
    scan = seeded.post(f"{AS_SCAN}&inspection_id={inspection['id']}").json()
    assert (seeded.delete(path).status_code, seeded.get(path).json()["code"]) == (204, "inspection-not-found")
    assert not store.files.upload(kinds.INSPECT, inspection["id"]).exists()
    assert store.files.upload(kinds.INGEST, scan["id"]).read_bytes() == CONTENT
    assert seeded.get("/v1/audit").json()["items"][0]["action"] == "inspection-deleted"


def test_a_file_that_has_been_removed_must_be_sent_again(seeded, store):
    store.files.remove_upload(kinds.INSPECT, "example")
    answer = seeded.post(f"{AS_SCAN}&inspection_id=example")
    assert (answer.status_code, answer.json()["code"]) == (409, "inspection-expired")
    assert "send it again" in answer.json()["detail"]
