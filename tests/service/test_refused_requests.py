"""What cannot be asked for is refused with its status and code, makes no job, and leaves no file."""

import pytest
from asgi import refusal

from sawmill_contracts import kinds
from sawmill_contracts.reconstructions import DECLARATION as RECONSTRUCTION
from sawmill_contracts.reconstructions import ReconstructionAsked

SCANS, EXAMPLE = "/v1/scans?scanner_id=example&data=counts", {"scan_id": "example"}
LINES = "/v1/scans?scanner_id=example&data=line-integrals"
LOG, PLANS = "/v1/reconstructions/example", "/v1/phantoms/l-shape/plans"
WRONG = (422, "invalid-request")
ASKED = [
    *((f"/v1/{kind}", {"scan_id": "nothing"}, 404, "scan-not-found") for kind in ("drifts", "calibrations")),
    *((f"/v1/{kind}", {}, *WRONG) for kind in ("drifts", "calibrations")),
    *((f"/v1/{kind}", EXAMPLE | {"rows": "4:4"}, *WRONG) for kind in ("drifts", "calibrations")),
    ("/v1/drifts", EXAMPLE | {"calibration_id": "nothing"}, 404, "calibration-not-found"),
    ("/v1/drifts", EXAMPLE | {"row": "0:1"}, *WRONG),
    ("/v1/calibrations", EXAMPLE | {"phantom_id": "nothing"}, 404, "phantom-not-found"),
    ("/v1/calibrations", EXAMPLE | {"sead": 1}, *WRONG),
    ("/v1/calibrations", EXAMPLE | {"views": 2}, *WRONG),
    ("/v1/reconstructions", EXAMPLE | {"rotation": "reversed"}, *WRONG),
    ("/v1/reconstructions", EXAMPLE | {"size": 1_000_000}, *WRONG),
    ("/v1/reconstructions", EXAMPLE | {"field_mm": -400}, *WRONG),
    ("/v1/phantoms/cube/plans", {"scanner_id": "example"}, 404, "phantom-not-found"),
    (PLANS, {"scanner_id": "line-9"}, 404, "scanner-not-found"),
    (PLANS, {"scanner_id": "example-spare"}, 409, "no-active-calibration"),
    (PLANS, {"scanner_id": "example", "noise": 0}, *WRONG),
    (PLANS, {"scanner_id": "example", "views": 2}, *WRONG),
    ("/v1/schedules", {"scanner_id": "nowhere", "cron": "30 5 * * 1-6"}, 404, "scanner-not-found"),
    ("/v1/uploads", {"size_bytes": 100_001}, 413, "upload-too-large"),
    ("/v1/uploads", {"size_bytes": 0}, *WRONG),
    ("/v1/uploads", {"size_bytes": 3, "sha256": "abc"}, *WRONG),
]
SENT = [
    ("/v1/scans?scanner_id=nowhere&data=counts", b"x", 404, "scanner-not-found"),
    (f"{SCANS}&phantom_id=nothing", b"x", 404, "phantom-not-found"),
    ("/v1/scans?scanner_id=example", b"x", *WRONG),
    ("/v1/scans?scanner_id=example&data=guess", b"x", *WRONG),
    ("/v1/scans?scanner_id=../etc&data=counts", b"x", *WRONG),
    (f"{SCANS}&phantom_rows=5:2", b"x", *WRONG),
    (f"{SCANS}&angle=3", b"x", *WRONG),
    (f"{SCANS}&align_rows=guess", b"x", *WRONG),
    (f"{LINES}&averaged_rows=0", b"x", *WRONG),
    (f"{LINES}&averaged_rows=9&align_rows=profile", b"x", *WRONG),
    (SCANS, b"", 422, "empty-body"),
    (SCANS, bytes(100_001), 413, "body-too-large"),
    ("/v1/inspections", b"", 422, "empty-body"),
    ("/v1/inspections", bytes(100_001), 413, "body-too-large"),
    ("/v1/inspections?data=guess", b"x", *WRONG),
    ("/v1/inspections?scanner_id=example", b"x", *WRONG),
    ("/v1/inspections?inspection_id=nothing", b"", 404, "inspection-not-found"),
    (f"{SCANS}&inspection_id=nothing", b"", 404, "inspection-not-found"),
    (f"{SCANS}&inspection_id=example", b"x", 422, "two-files"),
    ("/v1/scans?scanner_id=nowhere&data=counts&inspection_id=example", b"", 404, "scanner-not-found"),
    ("/v1/phantoms/pictures?name=ell", b"x", *WRONG),
    ("/v1/phantoms/pictures?name=ell&width_mm=-1", b"x", *WRONG),
    ("/v1/phantoms/pictures?name=&width_mm=400", b"x", *WRONG),
    ("/v1/phantoms/pictures?name=ell&width_mm=400", bytes(50_001), 413, "body-too-large"),
]
READ = [
    (f"{LOG}/slices/3.png", 404, "slice-not-found"),
    (f"{LOG}/slices/-1.png", *WRONG),
    (f"{LOG}/slices/0.png?bits=12", *WRONG),
    (f"{LOG}/slices/0.png?window_low=4", 422, "empty-window"),
    (f"{LOG}/slices/0.png?window_low=nan", *WRONG),
    (f"{LOG}/slices/0.png?window=4", *WRONG),
    (f"{LOG}/slices/3.npy", 404, "slice-not-found"),
    (f"{LOG}/slices/0.npy?max_size=15", *WRONG),
    (f"{LOG}/slices/3.jpg", 404, "slice-not-found"),
    (f"{LOG}/slices/0.jpg?window_low=2&window_high=1", 422, "empty-window"),
    (f"{LOG}/side.npy?along=z", *WRONG),
    (f"{LOG}/mosaic.png?count=65", *WRONG),
    (f"{LOG}/mosaic.png?count=4&slices=0:2", *WRONG),
    (f"{LOG}/mosaic.png?slices=2", *WRONG),
    (f"{LOG}/mosaic.png?slices=2:2", *WRONG),
    (f"{LOG}/mosaic.png?slices=0:3:0", *WRONG),
    (f"{LOG}/mosaic.png?slices=0:4", 404, "slice-not-found"),
    (f"{LOG}/mosaic.png?window_low=9", 422, "empty-window"),
    (f"{LOG}/mosaic.png?color_map=rainbow", *WRONG),
    ("/v1/reconstructions/nobody/slices/0.npy", 404, "reconstruction-not-found"),
    ("/v1/reconstructions/nobody/volume.tif", 404, "reconstruction-not-found"),
    ("/v1/reconstructions/nobody/thumbnail.png", 404, "reconstruction-not-found"),
    ("/v1/scans/nobody/thumbnail.png", 404, "scan-not-found"),
    ("/v1/jobs/nothing/events", 404, "job-not-found"),
    *((f"/v1/scanners/example/measurements?after={digits}", 422, "invalid-cursor") for digits in ("9" * 10, "9" * 18)),
    *((f"/v1/audit?after={digits}", 422, "invalid-cursor") for digits in ("9" * 10, "9" * 18)),
    *((path, *WRONG) for path in ("/scans?scanner_id=%00", "/logs?scanner_id=%00", "/scans?after=1.%00")),
]


@pytest.mark.parametrize(("path", "ask", "status", "code"), ASKED)
def test_what_cannot_be_asked_for_is_a_problem(seeded, woken, path, ask, status, code):
    assert (refusal(seeded.post(path, json=ask)), woken) == ((status, code), [])


@pytest.mark.parametrize(("path", "content", "status", "code"), SENT)
def test_a_file_that_is_refused_leaves_nothing(seeded, store, woken, path, content, status, code):
    before = sorted((store.files.folder / "uploads").rglob("*"))
    assert refusal(seeded.post(path, content=content)) == (status, code)
    assert (list((store.files.folder / "incoming").iterdir()), woken) == ([], [])
    assert sorted((store.files.folder / "uploads").rglob("*")) == before
    assert store.files.upload(kinds.INSPECT, "example").read_bytes() == b"original"


@pytest.mark.parametrize(("path", "status", "code"), READ)
def test_what_is_not_there_or_cannot_be_drawn_is_a_problem(seeded, path, status, code):
    answer = seeded.get(path)
    assert (answer.status_code, answer.json()["code"]) == (status, code)
    assert answer.headers["Content-Type"] == "application/problem+json"


@pytest.mark.parametrize(
    ("path", "asked", "code", "sentence"),
    [
        ("calibrations", {"rows": "2:5"}, "rows-outside", "rows is 2:5, but scan 'example' has rows 0:4 only"),
        ("calibrations", {"log_rows": "0:9"}, "rows-outside", "log_rows is 0:9, but scan 'example' has rows 0:4 only"),
        ("calibrations", {"views": 13}, "views-too-many", "views is 13, but scan 'example' has 12"),
        ("reconstructions", {"rows": "0:100:9"}, "rows-outside", "rows is 0:100:9, but"),
        ("drifts", {"rows": "4:5"}, "rows-outside", "rows is 4:5, but"),
    ],
)
def test_what_a_scan_that_has_been_read_lacks_is_refused_at_once(seeded, store, path, asked, code, sentence):
    before = len(store.jobs.page(limit=200).items)
    answer = seeded.post(f"/v1/{path}", json={"scan_id": "example", **asked})
    assert (answer.status_code, answer.json()["code"]) == (422, code)
    assert answer.json()["detail"].startswith(sentence)
    assert len(store.jobs.page(limit=200).items) == before


def test_a_reconstruction_that_an_earlier_version_accepted_is_listed(seeded, store):
    """Its parameters are beyond what may be asked for now."""
    asked = {"scan_id": "example", "method": "tikhonov", "alpha": 1e-300}
    answer = seeded.post("/v1/reconstructions", json=asked)
    assert "body.alpha must be from 1e-09 to 1e+09, not 1e-300" in answer.json()["detail"]
    kept = store.asked(RECONSTRUCTION).accept(ReconstructionAsked(**asked))
    assert seeded.get(f"/v1/reconstructions/{kept.id}").json()["options"]["alpha"] == 1e-300


@pytest.mark.parametrize("moment", ["0001-01-01T00:00:00%2B14:00", "9999-12-31T23:59:59-14:00"])
@pytest.mark.parametrize(
    "path",
    ["/v1/scans?created_from=", "/v1/reconstructions?created_before=", "/v1/scanners/example/measurements?since="],
)
def test_a_moment_that_no_calendar_holds_in_utc_is_refused(seeded, path, moment):
    answer = seeded.get(path + moment)
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid-request")
    assert "beyond what calendars hold" in answer.json()["detail"]
