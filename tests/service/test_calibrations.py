import asyncio
import io

import h5py
import pytest
from asgi import asynchronous, refusal
from damaged_files import written_by_its_job
from PIL import Image

from sawmill_contracts import kinds
from sawmill_platform.errors import NotFound
from sawmill_service.drawing import CalibrationPicture, calibration_picture
from sawmill_store.mill_files import MillFiles


def test_the_files_are_what_the_job_wrote(seeded, tmp_path):
    answer = seeded.get("/v1/calibrations/example/result.h5")
    (tmp_path / "copy.h5").write_bytes(answer.content)
    with h5py.File(tmp_path / "copy.h5") as file:
        assert file["entry/calibration/gain"][()] == 1.0
    assert 'filename="calibration-example.h5"' in answer.headers["Content-Disposition"]


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
    (store.files.results(kinds.CALIBRATE, "example") / "overlay.png").write_bytes(b"drawn by the job")
    assert seeded.get("/v1/calibrations/example/overlay.png").content == b"drawn by the job"


def test_a_picture_that_many_ask_for_at_once_is_drawn_once(seeded, drawn):
    async def ask_at_once():
        async with asynchronous(seeded.app) as client:
            asked = [client.get("/v1/calibrations/example/overlay.png") for _ in range(4)]
            return await asyncio.gather(*asked)

    answers = asyncio.run(ask_at_once())
    assert ({answer.status_code for answer in answers}, len({answer.content for answer in answers})) == ({200}, 1)
    assert len(drawn) == 1


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


def test_a_calibration_may_be_asked_for_while_its_scan_is_read(seeded):
    upload = "/v1/scans?scanner_id=example&data=counts&phantom_id=l-shape"
    scan = seeded.post(upload, content=b"x").json()
    assert seeded.post("/v1/calibrations", json={"scan_id": scan["id"]}).status_code == 202


def test_only_a_finished_calibration_is_activated_and_an_older_one_rolls_back(seeded, worker):
    newer = seeded.post("/v1/calibrations", json={"scan_id": "example", "activate": True}).json()["id"]
    worker.finish_calibration()
    assert seeded.get("/v1/scanners/example").json()["active_calibration_id"] == newer
    answer = seeded.post("/v1/calibrations/example/activate", json={"reason": "the new one blurs"})
    assert answer.json()["active_calibration_id"] == "example"
    assert seeded.get("/v1/scanners/example/history/entries").json()["items"][0]["why"] == "the new one blurs"
    path = seeded.post("/v1/calibrations", json={"scan_id": "example"}).headers["Location"]
    assert seeded.post(f"{path}/activate").status_code == 409


def test_the_log_before_and_after_are_of_one_size_and_one_window(seeded, store):
    before, after = (seeded.get(f"/v1/calibrations/example/log-{name}.png") for name in ("before", "after"))
    assert (before.status_code, after.status_code) == (200, 200)
    with Image.open(io.BytesIO(before.content)) as first, Image.open(io.BytesIO(after.content)) as second:
        assert first.size == second.size == (512, 512)
        # The same value, at the middle of the first and a quarter beside it in the second, is the same grey.
        assert abs(first.getpixel((136, 250)) - second.getpixel((264, 250))) < 12  # a pixel's step of the ramp
    assert (store.files.results(kinds.CALIBRATE, "example") / "log-before.png").read_bytes() == before.content


def test_a_calibration_that_shows_no_log_has_no_picture_of_one(seeded, store, worker):
    identifier = seeded.post("/v1/calibrations", json={"scan_id": "example"}).json()["id"]
    worker.finish_calibration()
    with h5py.File(store.files.result(kinds.CALIBRATE, identifier, "result.h5"), "r+") as file:
        del file["entry/arrays/log_before"]
    written_by_its_job(store, store.files.unverified(kinds.CALIBRATE, identifier, "result.h5"))
    assert refusal(seeded.get(f"/v1/calibrations/{identifier}/log-before.png")) == (404, "no-log")
