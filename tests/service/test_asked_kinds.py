"""What is asked of a scan or a phantom: accepted, waited for and answered, or refused with its status and code."""

import asyncio
import io

import h5py
import pytest
from asgi import asynchronous, refusal
from PIL import Image
from results import SCANNER_SPEC, THETA, written_by_its_job

from sawmill_contracts import fixed_pairs, kinds, pair_logs
from sawmill_contracts.reconstructions import StoredReconstructionOptions
from sawmill_platform.errors import NotFound
from sawmill_service.drawing import CalibrationPicture, calibration_picture
from sawmill_store.mill_files import MillFiles

PLANS = "/v1/phantoms/l-shape/plans"
EXAMPLE, KNOWN = {"scan_id": "example"}, ("calibration_id", "example")
BOARD, LOG = (declared.to_ask.example["body"] for declared in (fixed_pairs.DECLARATION, pair_logs.DECLARATION))
LINKS = ("volume", "first_slice", "mosaic", "side")
# Where it is asked for and how, what is known at once, and which links lead to nothing before its result.
KINDS = {
    "drift": ("/v1/drifts", EXAMPLE | {"rows": "0:2"}, KNOWN, ()),
    "reconstruction": ("/v1/reconstructions", EXAMPLE | {"size": 32}, KNOWN, LINKS),
    "plan": (PLANS, {"scanner_id": "example", "views": 20}, ("phantom_id", "l-shape"), ()),
    "fixed-pairs": ("/v1/fixed-pairs", BOARD, ("phantom_id", "l-shape"), ["ring"]),
    "pair-log": ("/v1/pair-logs", LOG, ("failure", None), ()),
    "calibration": ("/v1/calibrations", EXAMPLE | {"seed": 11}, ("phantom_id", "l-shape"), ["report"]),
}


@pytest.mark.parametrize("kind", KINDS)
def test_it_is_accepted_waited_for_and_answered(seeded, worker, woken, kind):
    path, ask, known, without = KINDS[kind]
    accepted = seeded.post(path, json=ask)
    assert (accepted.status_code, accepted.headers["Retry-After"]) == (202, "1")
    address = accepted.headers["Location"]
    queued = seeded.get(address).json()
    assert (queued["state"], woken, queued[known[0]]) == ("queued", [queued["job_id"]], known[1])
    name, value = list(ask.items())[-1]
    assert queued["options"][name] == value
    for link in without:
        assert seeded.get(queued["links"][link]).json()["code"] == f"{kind}-without-result"
    getattr(worker, f"finish_{kind.replace('-', '_')}")()
    answer = seeded.get(address).json()
    assert answer["state"] == "succeeded"
    # The report takes seconds to draw; `test_openapi` asks for it.
    assert answer["links"].pop("report", None) == (f"{address}/report.png" if kind == "calibration" else None)
    for link in answer["links"].values():
        assert seeded.get(link).status_code == 200


def test_lists_are_narrowed_and_an_answer_has_the_job_s_result(seeded, store):
    for kind in ("calibrations", "drifts"):
        seeded.post(f"/v1/{kind}", json={"scan_id": "example"})
        listed = {state: seeded.get(f"/v1/{kind}?state={state}").json()["items"] for state in ("queued", "succeeded")}
        assert [item["id"] for item in listed["succeeded"]] == ["example"]
        assert (listed["succeeded"][0]["links"]["self"], len(listed["queued"])) == (f"/v1/{kind}/example", 1)
        assert seeded.get(f"/v1/{kind}?scanner_id=example-spare").json()["items"] == []
    assert [item["id"] for item in seeded.get("/v1/plans?phantom_id=l-shape").json()["items"]] == ["example"]
    assert seeded.get("/v1/plans?phantom_id=rectangle-with-hole").json()["items"] == []
    assert {job["kind"] for job in seeded.get("/v1/jobs?kind=drift").json()["items"]} == {"drift"}
    plan = seeded.post(PLANS, json={"scanner_id": "example"}).json()
    assert plan["options"]["noise"] == 0.02
    assert store.jobs.get(plan["job_id"]).kind is kinds.PLAN
    calibration = seeded.get("/v1/calibrations/example").json()
    assert (calibration["verdict"], calibration["source_frame"]["source_distance_mm"]) == ("pass", 917.1)
    assert seeded.get("/v1/drifts/example").json()["result"]["within_tolerance"] is True
    assert seeded.get("/v1/plans/example").json()["result"]["predicted_ray_error_mm"]["rms"] == 0.02
    assert seeded.get("/v1/reconstructions/example").json()["result"]["shape"] == [3, 32, 32]


def test_files_are_what_the_job_wrote_and_both_pictures_of_the_log_of_one_window(seeded, tmp_path, store, worker):
    answer = seeded.get("/v1/calibrations/example/result.h5")
    (tmp_path / "copy.h5").write_bytes(answer.content)
    with h5py.File(tmp_path / "copy.h5") as file:
        assert file["entry/calibration/gain"][()] == 1.0
    assert 'filename="calibration-example.h5"' in answer.headers["Content-Disposition"]
    before, after = (seeded.get(f"/v1/calibrations/example/log-{name}.png") for name in ("before", "after"))
    assert (before.status_code, after.status_code) == (200, 200)
    with Image.open(io.BytesIO(before.content)) as first, Image.open(io.BytesIO(after.content)) as second:
        assert first.size == second.size == (512, 512)
        # The same value, at the middle of the first and a quarter beside it in the second, is the same grey.
        assert abs(first.getpixel((136, 250)) - second.getpixel((264, 250))) < 12  # a pixel's step of the ramp
    assert (store.files.results(kinds.CALIBRATE, "example") / "log-before.png").read_bytes() == before.content
    identifier = seeded.post("/v1/calibrations", json={"scan_id": "example"}).json()["id"]
    worker.finish_calibration()
    with h5py.File(store.files.result(kinds.CALIBRATE, identifier, "result.h5"), "r+") as file:
        del file["entry/arrays/log_before"]
    written_by_its_job(store, store.files.unverified(kinds.CALIBRATE, identifier, "result.h5"))
    assert refusal(seeded.get(f"/v1/calibrations/{identifier}/log-before.png")) == (404, "no-log")


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
    store.calibrations.files = store.files = WatchedFiles(store.files)
    return store.files.made


def test_a_picture_is_drawn_when_it_is_first_asked_for_and_kept(seeded, store, drawn):
    folder = store.files.results(kinds.CALIBRATE, "example")
    assert [path.name for path in folder.iterdir()] == ["result.h5"]
    first, second = (seeded.get("/v1/calibrations/example/overlay.png") for _ in range(2))
    assert drawn == ["overlay.png"]
    assert first.content == second.content == (folder / "overlay.png").read_bytes()
    assert Image.open(io.BytesIO(first.content)).size in {(900, 820), (900, 819)}  # as Matplotlib rounds
    assert {path.name for path in folder.iterdir()} == {"result.h5", "overlay.png"}
    (store.files.results(kinds.CALIBRATE, "example") / "overlay.png").write_bytes(b"drawn by the job")
    assert seeded.get("/v1/calibrations/example/overlay.png").content == b"drawn by the job"


def test_a_picture_that_many_ask_for_at_once_is_drawn_once(seeded, drawn):
    async def ask_at_once():
        async with asynchronous(seeded.app) as client:
            return await asyncio.gather(*[client.get("/v1/calibrations/example/overlay.png") for _ in range(4)])

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


def test_only_a_finished_calibration_is_activated_an_older_one_rolls_back_and_a_scan_may_still_be_read(seeded, worker):
    newer = seeded.post("/v1/calibrations", json={"scan_id": "example", "activate": True}).json()["id"]
    worker.finish_calibration()
    assert seeded.get("/v1/scanners/example").json()["active_calibration_id"] == newer
    answer = seeded.post("/v1/calibrations/example/activate", json={"reason": "the new one blurs"})
    assert answer.json()["active_calibration_id"] == "example"
    assert seeded.get("/v1/scanners/example/history/entries").json()["items"][0]["why"] == "the new one blurs"
    path = seeded.post("/v1/calibrations", json={"scan_id": "example"}).headers["Location"]
    assert seeded.post(f"{path}/activate").status_code == 409
    scan = seeded.post("/v1/scans?scanner_id=example&data=counts&phantom_id=l-shape", content=b"x").json()
    assert seeded.post("/v1/calibrations", json={"scan_id": scan["id"]}).status_code == 202


SCANS, LOG = "/v1/scans?scanner_id=example&data=counts", "/v1/reconstructions/example"
LINES, PICTURES = "/v1/scans?scanner_id=example&data=line-integrals", "/v1/phantoms/pictures?name=ell&width_mm="
CALIBRATIONS, DRIFTS, WRONG = "/v1/calibrations", "/v1/drifts", (422, "invalid-request")
NOT_ASKED = {
    CALIBRATIONS: [{}, EXAMPLE | {"rows": "4:4"}, EXAMPLE | {"sead": 1}, EXAMPLE | {"views": 2}],
    DRIFTS: [{}, EXAMPLE | {"rows": "4:4"}, EXAMPLE | {"row": "0:1"}],
    "/v1/reconstructions": [
        EXAMPLE | {"rotation": "reversed"},
        EXAMPLE | {"size": 10**6},
        EXAMPLE | {"field_mm": -400},
    ],
    PLANS: [{"scanner_id": "example", "noise": 0}, {"scanner_id": "example", "views": 2}],
    "/v1/uploads": [{"size_bytes": 0}, {"size_bytes": 3, "sha256": "abc"}],
}
ASKED = [
    *((path, ask, *WRONG) for path, asks in NOT_ASKED.items() for ask in asks),
    *((path, {"scan_id": "nothing"}, 404, "scan-not-found") for path in (CALIBRATIONS, DRIFTS)),
    (DRIFTS, EXAMPLE | {"calibration_id": "nothing"}, 404, "calibration-not-found"),
    (CALIBRATIONS, EXAMPLE | {"phantom_id": "nothing"}, 404, "phantom-not-found"),
    ("/v1/phantoms/cube/plans", {"scanner_id": "example"}, 404, "phantom-not-found"),
    (PLANS, {"scanner_id": "line-9"}, 404, "scanner-not-found"),
    (PLANS, {"scanner_id": "example-spare"}, 409, "no-active-calibration"),
    ("/v1/schedules", {"scanner_id": "nowhere", "cron": "30 5 * * 1-6"}, 404, "scanner-not-found"),
    ("/v1/uploads", {"size_bytes": 100_001}, 413, "upload-too-large"),
]
NOT_SENT = [
    *(
        "/v1/scans?scanner_id=example",
        "/v1/scans?scanner_id=example&data=guess",
        "/v1/scans?scanner_id=../etc&data=counts",
    ),
    *(f"{SCANS}&{field}" for field in ("phantom_rows=5:2", "angle=3", "align_rows=guess")),
    *(f"{LINES}&{fields}" for fields in ("averaged_rows=0", "averaged_rows=9&align_rows=profile")),
    *("/v1/inspections?data=guess", "/v1/inspections?scanner_id=example", f"{PICTURES}-1"),
    *("/v1/phantoms/pictures?name=ell", "/v1/phantoms/pictures?name=&width_mm=400"),
]
SENT = [
    *((path, b"x", *WRONG) for path in NOT_SENT),
    *((path, b"", 422, "empty-body") for path in (SCANS, "/v1/inspections")),
    *((path, bytes(100_001), 413, "body-too-large") for path in (SCANS, "/v1/inspections")),
    (f"{PICTURES}400", bytes(50_001), 413, "body-too-large"),
    ("/v1/scans?scanner_id=nowhere&data=counts", b"x", 404, "scanner-not-found"),
    ("/v1/scans?scanner_id=nowhere&data=counts&inspection_id=example", b"", 404, "scanner-not-found"),
    (f"{SCANS}&phantom_id=nothing", b"x", 404, "phantom-not-found"),
    ("/v1/inspections?inspection_id=nothing", b"", 404, "inspection-not-found"),
    (f"{SCANS}&inspection_id=nothing", b"", 404, "inspection-not-found"),
    (f"{SCANS}&inspection_id=example", b"x", 422, "two-files"),
]
NOT_READ = (
    *("slices/-1.png", "slices/0.png?bits=12", "slices/0.png?window_low=nan", "slices/0.png?window=4"),
    *("slices/0.npy?max_size=15", "side.npy?along=z", "mosaic.png?count=65", "mosaic.png?count=4&slices=0:2"),
    *("mosaic.png?slices=2", "mosaic.png?slices=2:2", "mosaic.png?slices=0:3:0", "mosaic.png?color_map=rainbow"),
)
EMPTY = ("slices/0.png?window_low=4", "slices/0.jpg?window_low=2&window_high=1", "mosaic.png?window_low=9")
NO_SLICE = ("slices/3.png", "slices/3.npy", "slices/3.jpg", "mosaic.png?slices=0:4")
READ = [
    *((f"{LOG}/{path}", *WRONG) for path in NOT_READ),
    *((path, *WRONG) for path in ("/scans?scanner_id=%00", "/logs?scanner_id=%00", "/scans?after=1.%00")),
    *((f"{LOG}/{path}", 422, "empty-window") for path in EMPTY),
    *((f"{LOG}/{path}", 404, "slice-not-found") for path in NO_SLICE),
    *(
        (f"/v1/reconstructions/nobody/{path}", 404, "reconstruction-not-found")
        for path in ("slices/0.npy", "volume.tif")
    ),
    ("/v1/reconstructions/nobody/thumbnail.png", 404, "reconstruction-not-found"),
    ("/v1/scans/nobody/thumbnail.png", 404, "scan-not-found"),
    ("/v1/jobs/nothing/events", 404, "job-not-found"),
    *((f"/v1/scanners/example/measurements?after={digits}", 422, "invalid-cursor") for digits in ("9" * 10, "9" * 18)),
    *((f"/v1/audit?after={digits}", 422, "invalid-cursor") for digits in ("9" * 10, "9" * 18)),
]


def test_what_cannot_be_asked_for_or_a_scan_that_has_been_read_lacks_is_a_problem(seeded, woken, store):
    for path, ask, status, code in ASKED:
        assert (*refusal(seeded.post(path, json=ask)), woken) == (status, code, []), (path, ask)
    before = len(store.jobs.page(limit=200).items)
    for path, asked, code, sentence in (
        ("calibrations", {"rows": "2:5"}, "rows-outside", "rows is 2:5, but scan 'example' has rows 0:4 only"),
        ("calibrations", {"log_rows": "0:9"}, "rows-outside", "log_rows is 0:9, but scan 'example' has rows 0:4 only"),
        ("calibrations", {"views": 13}, "views-too-many", "views is 13, but scan 'example' has 12"),
        ("reconstructions", {"rows": "0:100:9"}, "rows-outside", "rows is 0:100:9, but"),
        ("drifts", {"rows": "4:5"}, "rows-outside", "rows is 4:5, but"),
    ):
        answer = seeded.post(f"/v1/{path}", json={"scan_id": "example", **asked})
        assert refusal(answer) == (422, code)
        assert answer.json()["detail"].startswith(sentence)
    assert len(store.jobs.page(limit=200).items) == before


def test_a_file_that_is_refused_leaves_nothing(seeded, store, woken):
    before = sorted((store.files.folder / "uploads").rglob("*"))
    for path, content, status, code in SENT:
        assert refusal(seeded.post(path, content=content)) == (status, code), path
        assert (list((store.files.folder / "incoming").iterdir()), woken) == ([], [])
        assert sorted((store.files.folder / "uploads").rglob("*")) == before, path
    assert store.files.upload(kinds.INSPECT, "example").read_bytes() == b"original"


def test_what_is_not_there_cannot_be_drawn_or_is_of_no_calendar_is_a_problem(seeded):
    for path, status, code in READ:
        answer = seeded.get(path)
        assert (*refusal(answer), answer.headers["Content-Type"]) == (status, code, "application/problem+json"), path
    of_times = ("scans?created_from", "reconstructions?created_before", "scanners/example/measurements?since")
    for moment in ("0001-01-01T00:00:00%2B14:00", "9999-12-31T23:59:59-14:00"):
        for path in of_times:
            answer = seeded.get(f"/v1/{path}={moment}")
            assert refusal(answer) == WRONG
            assert "beyond what calendars hold" in answer.json()["detail"]


def test_a_reconstruction_that_an_earlier_version_accepted_is_listed(seeded, store):
    for asked, words in (
        ({"method": "tikhonov", "alpha": 1e-300}, "body.alpha must be from 1e-09 to 1e+09, not 1e-300"),
        ({"theta": THETA | {"detector_shift_mm": 1e300}}, "should be less than or equal to 100000, not 1e+300"),
    ):
        assert words in seeded.post("/v1/reconstructions", json=EXAMPLE | asked).json()["detail"]
        kept = store.reconstructions.accept(StoredReconstructionOptions(**EXAMPLE, **asked))
        assert asked.items() <= seeded.get(f"/v1/reconstructions/{kept.id}").json()["options"].items()


@pytest.mark.parametrize("verdict", ["pass", "fail"])
def test_a_job_s_last_answer_alone_is_waited_for_with_a_new_scanner(client, store, worker, verdict):
    """The reconstruction waits for the first activation; a calibration that does not pass makes no log."""
    scanner_id = client.post("/v1/scanners", json=SCANNER_SPEC).json()["id"]
    about = {"scanner_id": scanner_id, "data": "line-integrals", "phantom_id": "l-shape"}
    scan = client.post("/v1/scans", params=about, content=b"x").json()["id"]
    assert client.post("/v1/reconstructions", json={"scan_id": scan}).json()["code"] == "no-active-calibration"
    calibration = client.post("/v1/calibrations", json={"scan_id": scan, "activate": True}).json()["id"]
    log = client.post("/v1/reconstructions", json={"scan_id": scan}).json()
    given = client.post("/v1/reconstructions", json={"scan_id": scan, "theta": THETA}).json()
    assert (log["state"], log["calibration_id"]) == ("queued", None)
    worker.finish_scan()
    worker.finish_calibration(rays_verdict=verdict, verdict=verdict)
    awaited = client.get(f"/v1/reconstructions/{log['id']}").json()["calibration_id"]
    handed = store.jobs.handed_over(log["job_id"]).calibration
    assert (awaited, handed and handed.id) == ((calibration,) * 2 if verdict == "pass" else (None, None))
    assert client.get(f"/v1/reconstructions/{given['id']}").json()["calibration_id"] is None
