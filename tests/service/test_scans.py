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


def leftovers(store: Store) -> list[str]:
    uploads = [path for path in (store.files.folder / "uploads/scans").glob("*") if not path.name.startswith("example")]
    return [path.name for path in (*(store.files.folder / "incoming").iterdir(), *uploads)]


def test_an_upload_is_kept_as_it_came_and_read_by_a_job(seeded, store, woken):
    content = np.random.default_rng(1).bytes(5000)
    answer = seeded.post(UPLOAD + "&name=morning&phantom_id=l-shape&phantom_rows=0:2", content=content)
    assert (answer.status_code, answer.headers["Retry-After"]) == (202, "1")
    scan = seeded.get(answer.headers["Location"]).json()
    assert (scan["state"], scan["name"], scan["size_bytes"], woken) == ("ingesting", "morning", 5000, [scan["job_id"]])
    assert (store.files.folder / "uploads/scans" / scan["id"] / "original").read_bytes() == content


def test_how_a_scan_is_prepared_is_given_at_the_upload_and_the_wake_up_goes_out_after_the_commit(
    seeded, store, settings
):
    answer = seeded.post(UPLOAD + "&air=background&rings=sorting&align_rows=profile", content=b"x")
    scan = seeded.get(answer.headers["Location"]).json()
    assert [scan[name] for name in ("air", "faulty_cells", "rings", "align_rows")] == [
        "background",
        "auto",
        "sorting",
        "profile",
    ]
    seen = []
    seeded.app = create_app(settings, store, lambda job_id: seen.append(store.jobs.get(job_id).state))
    assert (seeded.post(UPLOAD, content=b"x").status_code, seen) == (202, ["queued"])


def test_the_mean_of_rows_is_sent_as_line_integrals_and_never_as_counts(seeded, store, woken):
    mean = "/v1/scans?scanner_id=example&averaged_rows=1000&data="
    refused = seeded.post(mean + "counts", content=b"x")
    assert (refused.status_code, refused.json()["code"], woken) == (422, "invalid-request", [])
    (error,) = refused.json()["errors"]
    assert "-ln of a mean is not the mean of -ln, so take -ln((counts - dark) / (flat - dark))" in error["message"]
    assert leftovers(store) == []
    answer = seeded.post(mean + "line-integrals&angles_deg=9:18", content=b"x")
    assert seeded.get(answer.headers["Location"]).json()["averaged_rows"] == 1000
    assert seeded.get("/v1/scans/example").json()["averaged_rows"] is None


def test_an_undeclared_size_above_the_limit_is_refused_while_it_streams(seeded, store, settings):
    sent = 0

    async def endless():
        nonlocal sent
        while True:
            sent += 10_000
            yield bytes(10_000)

    assert refusal(seeded.post(UPLOAD, content=endless())) == (413, "body-too-large")
    assert sent <= settings.max_upload_bytes + 10_000
    assert leftovers(store) == []


@pytest.mark.parametrize("declared", ["3", "4000", "-1", "many"])
def test_a_false_content_length_is_refused(seeded, store, declared):
    assert refusal(seeded.post(UPLOAD, content=b"1234", headers={"Content-Length": declared})) == (400, "bad-length")
    assert leftovers(store) == []


def test_a_client_that_goes_away_leaves_nothing(seeded, store, woken):
    messages = iter([{"type": "http.request", "body": b"half", "more_body": True}, {"type": "http.disconnect"}])
    sent = []

    async def receive():
        return next(messages)

    async def send(message):
        sent.append(message)

    asyncio.run(seeded.app(scope_of(UPLOAD, "POST"), receive, send))
    assert (sent, leftovers(store), woken) == ([], [], [])


def test_scans_are_listed_and_deleted_with_their_files_unless_a_job_needs_them(seeded, store):
    path = seeded.post(UPLOAD, content=b"x").headers["Location"]
    assert len(seeded.get("/v1/scans").json()["items"]) == 3
    assert len(seeded.get("/v1/scans?state=ready").json()["items"]) == 2
    assert seeded.get("/v1/scans?scanner_id=example-spare").json()["items"] == []
    assert seeded.delete("/v1/scans/example-spare").status_code == 204
    assert seeded.get("/v1/scans/example-spare").status_code == 404
    assert not (store.files.folder / "scans/example-spare").exists()
    assert seeded.delete(path).json()["code"] == "scan-in-use"
    assert refusal(seeded.get(f"{path}/preview")) == (409, "scan-ingesting")


def test_a_sinogram_is_drawn_and_not_drawn_twice_and_the_preview_is_the_middle_row(seeded):
    first = seeded.get("/v1/scans/example/sinogram.png?row=1")
    assert Image.open(io.BytesIO(first.content)).format == "PNG"
    other = seeded.get("/v1/scans/example/sinogram.png?row=2", headers={"If-None-Match": first.headers["ETag"]})
    assert other.status_code == 200
    assert other.content != first.content
    assert seeded.get("/v1/scans/example/preview").content == other.content, "the middle row"


@pytest.mark.parametrize("row", ["4", "-1", "one", "99999999999999999999999"])
def test_a_row_that_is_not_there_is_a_problem(seeded, row):
    answer = seeded.get(f"/v1/scans/example/sinogram.png?row={row}")
    assert answer.status_code == 422
    assert row in answer.json()["detail"]


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
