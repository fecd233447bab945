import asyncio
import io

import h5py
import httpx
import pytest
from damaged_files import written_by_its_job
from PIL import Image

from sawmill_contracts import kinds
from sawmill_platform.errors import NotFound
from sawmill_service.drawing import CalibrationPicture, calibration_picture
from sawmill_store.mill_files import MillFiles


@pytest.mark.slow
def test_a_calibration_is_accepted_waited_for_and_answered(seeded, worker, woken):
    accepted = seeded.post("/v1/calibrations", json={"scan_id": "example", "seed": 11})
    assert accepted.status_code == 202
    path = accepted.headers["Location"]
    queued = seeded.get(path).json()
    assert (queued["state"], queued["phantom_id"], queued["options"]["seed"]) == ("queued", "l-shape", 11)
    assert woken == [queued["job_id"]]
    assert seeded.get(queued["links"]["report"]).json()["code"] == "calibration-without-result"
    worker.finish_calibration()
    answer = seeded.get(path).json()
    assert (answer["state"], answer["verdict"], answer["source_frame"]["source_distance_mm"]) == (
        "succeeded",
        "pass",
        917.1,
    )
    for link in answer["links"].values():
        assert seeded.get(link).status_code == 200


def test_the_files_are_what_the_job_wrote(seeded, tmp_path):
    answer = seeded.get("/v1/calibrations/example/result.h5")
    (tmp_path / "copy.h5").write_bytes(answer.content)
    with h5py.File(tmp_path / "copy.h5") as file:
        assert file["entry/calibration/gain"][()] == 1.0
    assert 'filename="calibration-example.h5"' in answer.headers["Content-Disposition"]
    held = {"If-None-Match": answer.headers["ETag"]}
    assert seeded.get("/v1/calibrations/example/result.h5", headers=held).status_code == 304


class WatchedFiles(MillFiles):
    """A data folder that counts how often something is made for it, and tells of it before that is kept."""

    def __init__(self, files):
        super().__init__(files.folder)
        self.verified = files.verified
        self.made, self.before_keeping = [], lambda: None

    def kept(self, kind, subject_id, name, make, **options):
        def counted():
            content = make()
            self.made.append(name)
            self.before_keeping()
            return content

        return super().kept(kind, subject_id, name, counted, **options)


@pytest.fixture
def drawn(store):
    """The pictures that were drawn."""
    store.calibrations.files = store.files = WatchedFiles(store.files)
    return store.files.made


def test_a_picture_is_drawn_when_it_is_first_asked_for_and_kept(seeded, store, drawn):
    folder = store.files.results(kinds.CALIBRATE, "example")
    assert [path.name for path in folder.iterdir()] == ["result.h5"]
    first, second = (seeded.get("/v1/calibrations/example/overlay.png") for _ in range(2))
    assert drawn == ["overlay.png"]
    assert first.content == second.content == (folder / "overlay.png").read_bytes()
    assert Image.open(io.BytesIO(first.content)).size == (900, 820)
    assert {path.name for path in folder.iterdir()} == {"result.h5", "overlay.png"}
    held = {"If-None-Match": first.headers["ETag"]}
    assert seeded.get("/v1/calibrations/example/overlay.png", headers=held).status_code == 304


def test_a_picture_that_many_ask_for_at_once_is_drawn_once(seeded, drawn):
    async def ask_at_once():
        transport = httpx.ASGITransport(seeded.app)
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1:8000", timeout=60) as client:
            asked = [client.get("/v1/calibrations/example/overlay.png") for _ in range(4)]
            return await asyncio.gather(*asked)

    answers = asyncio.run(ask_at_once())
    assert {answer.status_code for answer in answers} == {200}
    assert len({answer.content for answer in answers}) == 1
    assert len(drawn) == 1


def test_a_picture_of_an_older_version_stays(seeded, store):
    (store.files.results(kinds.CALIBRATE, "example") / "overlay.png").write_bytes(b"drawn by the job")
    assert seeded.get("/v1/calibrations/example/overlay.png").content == b"drawn by the job"


def test_a_report_is_drawn_once_in_each_language(seeded, store):
    path = "/v1/calibrations/example/report.png"
    drawn = {language: seeded.get(f"{path}?language={language}") for language in ("en", "fi")}
    assert [answer.status_code for answer in drawn.values()] == [200, 200]
    assert drawn["en"].content == seeded.get(path).content != drawn["fi"].content
    kept = store.files.results(kinds.CALIBRATE, "example").glob("report-*.png")
    assert sorted(each.name[:9] for each in kept) == ["report-en", "report-fi"]


@pytest.mark.usefixtures("seeded")
def test_a_picture_cannot_outlive_its_calibration(store, drawn):
    folder = store.files.results(kinds.CALIBRATE, "example")
    store.files.before_keeping = lambda: store.files.remove(folder)
    with pytest.raises(NotFound):
        calibration_picture(store.files, "example", CalibrationPicture.OVERLAY)
    assert drawn == ["overlay.png"]
    assert not folder.exists()
    assert list((store.files.folder / "incoming").iterdir()) == []


@pytest.mark.parametrize(
    ("ask", "status", "code"),
    [
        ({"scan_id": "nothing"}, 404, "scan-not-found"),
        ({"scan_id": "example", "phantom_id": "nothing"}, 404, "phantom-not-found"),
        ({}, 422, "invalid-request"),
        ({"scan_id": "example", "sead": 1}, 422, "invalid-request"),
        ({"scan_id": "example", "rows": "4:4"}, 422, "invalid-request"),
        ({"scan_id": "example", "views": 2}, 422, "invalid-request"),
    ],
)
def test_a_calibration_that_cannot_be_is_a_problem(seeded, woken, ask, status, code):
    answer = seeded.post("/v1/calibrations", json=ask)
    assert (answer.status_code, answer.json()["code"]) == (status, code)
    assert woken == []


def test_a_calibration_may_be_asked_for_while_its_scan_is_read(seeded):
    upload = "/v1/scans?scanner_id=example&data=counts&phantom_id=l-shape"
    scan = seeded.post(upload, content=b"x").json()
    assert seeded.post("/v1/calibrations", json={"scan_id": scan["id"]}).status_code == 202


def test_activating_an_older_one_rolls_back(seeded, worker):
    newer = seeded.post("/v1/calibrations", json={"scan_id": "example", "activate": True}).json()["id"]
    worker.finish_calibration()
    assert seeded.get("/v1/scanners/example").json()["active_calibration_id"] == newer
    answer = seeded.post("/v1/calibrations/example/activate", json={"reason": "the new one blurs"})
    assert answer.json()["active_calibration_id"] == "example"
    assert seeded.get("/v1/scanners/example/history/entries").json()["items"][0]["why"] == "the new one blurs"


def test_activating_needs_no_body(seeded):
    assert seeded.post("/v1/calibrations/example/activate").status_code == 200


def test_an_unfinished_calibration_cannot_be_activated(seeded):
    path = seeded.post("/v1/calibrations", json={"scan_id": "example"}).headers["Location"]
    assert seeded.post(f"{path}/activate").status_code == 409


def test_calibrations_are_listed_by_scanner_and_state(seeded):
    seeded.post("/v1/calibrations", json={"scan_id": "example"})
    listed = {state: seeded.get(f"/v1/calibrations?state={state}").json()["items"] for state in ("queued", "succeeded")}
    assert [item["id"] for item in listed["succeeded"]] == ["example"]
    assert listed["succeeded"][0]["links"]["self"] == "/v1/calibrations/example"
    assert len(listed["queued"]) == 1
    assert seeded.get("/v1/calibrations?scanner_id=example-spare").json()["items"] == []


def test_the_log_before_and_after_are_of_one_size_and_one_window(seeded, store):
    before, after = (seeded.get(f"/v1/calibrations/example/log-{name}.png") for name in ("before", "after"))
    assert (before.status_code, after.status_code) == (200, 200)
    with Image.open(io.BytesIO(before.content)) as first, Image.open(io.BytesIO(after.content)) as second:
        assert first.size == second.size == (512, 512)
        # The same value, at the middle of the first and a quarter beside it in the second, is the same grey.
        assert abs(first.getpixel((136, 250)) - second.getpixel((264, 250))) < 12  # a pixel's step of the ramp
    folder = store.files.results(kinds.CALIBRATE, "example")
    assert (folder / "log-before.png").read_bytes() == before.content


def test_a_calibration_that_shows_no_log_has_no_picture_of_one(seeded, store, worker):
    identifier = seeded.post("/v1/calibrations", json={"scan_id": "example"}).json()["id"]
    worker.finish_calibration()
    with h5py.File(store.files.result(kinds.CALIBRATE, identifier, "result.h5"), "r+") as file:
        del file["entry/arrays/log_before"]
    written_by_its_job(store, store.files.unverified(kinds.CALIBRATE, identifier, "result.h5"))
    refused = seeded.get(f"/v1/calibrations/{identifier}/log-before.png")
    assert (refused.status_code, refused.json()["code"]) == (404, "no-log")
