import re

import pytest

from sawmill_worker.contracts.calibrations import CalibrationAsk
from sawmill_worker.contracts.jobs import Failure, FailureKind
from sawmill_worker.contracts.scans import ScanSpec
from sawmill_worker.vocabulary import DataKind


def comparison(*, within: bool) -> dict:
    return {
        "calibration_id": "example",
        "ray_change_mm": 0.75,
        "angle_change_deg": 0.1,
        "cor_column_change_mm": -1.25,
        "source_distance_change_mm": 2.5,
        "tilt_change_deg": 0.05,
        "within_tolerance": within,
        "reason": "the rays moved by 0.75 mm <RMS>",
    }


@pytest.fixture
def newest(seeded, worker):
    """Adds a newer calibration with this outcome and returns its id."""

    def add(**changes):
        identifier = seeded.post("/v1/calibrations", json={"scan_id": "example"}).json()["id"]
        worker.finish_calibration(**changes)
        return identifier

    return add


def cards(client) -> list[str]:
    """One a scanner, the spare one first."""
    return client.get("/").text.split("<section")[1:]


def badge(card: str) -> str:
    return re.search(r'class="badge">([^<]+)<', card)[1]


def test_a_fresh_service_shows_what_to_do(client):
    assert "There is no scanner yet" in client.get("/").text


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({}, "In tolerance"),
        ({"comparison": comparison(within=True)}, "In tolerance"),
        ({"comparison": comparison(within=False)}, "Out of tolerance"),
        ({"verdict": "watch", "reasons": ["h_S is not resolved."]}, "Watch"),
        ({"verdict": "fail", "reasons": ["The residual is too large."]}, "Calibration failed its check"),
    ],
)
def test_each_scanner_shows_whether_it_is_in_tolerance(seeded, newest, changes, word):
    newest(**changes)
    spare, example = cards(seeded)
    assert badge(spare) == "Not calibrated"
    assert badge(example) == word
    assert all(reason in example for reason in changes.get("reasons", []))


def test_a_passing_calibration_that_nobody_accepted_is_not_in_tolerance(seeded, store, worker):
    spec = ScanSpec(scanner_id="example-spare", data=DataKind.COUNTS, phantom_id="l-shape")
    store.scans.accept(spec, store.files.receive([b"x"], max_bytes=10), scan_id="spare")
    worker.finish_scan()
    store.calibrations.accept(CalibrationAsk(scan_id="spare"))
    worker.finish_calibration()
    assert badge(cards(seeded)[0]) == "No active calibration"


def test_the_page_shows_what_moved_in_millimetres(seeded, newest):
    newest(comparison=comparison(within=False))
    example = cards(seeded)[1]
    for moved in ("0.750 mm RMS", "-1.250 mm", "+2.500 mm", "+0.050°"):
        assert moved in example


def test_a_calibration_that_failed_since_is_shown(seeded, store, worker):
    seeded.post("/v1/calibrations", json={"scan_id": "example"})
    failure = Failure(kind=FailureKind.INPUT, code="phantom-not-found", detail="no phantom in rows 0:4")
    store.jobs.fail(worker.claim(), failure)
    assert "no phantom in rows 0:4" in cards(seeded)[1]
    seeded.post("/v1/calibrations", json={"scan_id": "example"})
    worker.finish_calibration()
    assert "no phantom in rows 0:4" not in cards(seeded)[1]


@pytest.fixture
def checked(seeded, worker):
    """Adds a newer drift check with this outcome, or none, and returns its id."""

    def add(**changes):
        identifier = seeded.post("/v1/drifts", json={"scan_id": "example"}).json()["id"]
        worker.finish_drift(**changes)
        return identifier

    return add


def drift_line(card: str) -> str:
    return re.search(r'<p class="drift.*?</p>', card)[0]


OUT = {"within_tolerance": False, "ray_change_mm": 0.8, "reason": "the COR moved <0.81 mm>: look at the turntable"}


@pytest.mark.parametrize(
    ("changes", "tone", "shown", "word"),
    [
        ({}, "good", "In tolerance: rays moved 0.010 mm RMS of 0.5 mm allowed, COR +0.100 mm", "In tolerance"),
        (OUT, "bad", "Out of tolerance: rays moved 0.800 mm RMS of 0.5 mm allowed", "Out of tolerance"),
        ({"within_tolerance": None, "reason": "too round"}, "watch", "Could not be seen: too round", "In tolerance"),
    ],
)
def test_one_line_shows_the_newest_drift_check(seeded, checked, changes, tone, shown, word):
    identifier = checked(**changes)
    spare, example = cards(seeded)
    assert 'class="drift' not in spare
    line = drift_line(example)
    assert f'class="drift {tone}"' in line
    assert f'href="/v1/drifts/{identifier}"' in line
    assert re.search(r"<time>20\d\d-\d\d-\d\d \d\d:\d\d UTC</time>", line)
    assert shown in line
    assert badge(example) == word


def test_a_log_that_shows_a_scanner_out_of_tolerance_gives_the_reason(seeded, checked, newest):
    checked(**OUT)
    assert "A log shows: the COR moved &lt;0.81 mm&gt;: look at the turntable." in cards(seeded)[1]
    newest(comparison=comparison(within=True))
    assert badge(cards(seeded)[1]) == "In tolerance"


def test_a_drift_check_that_failed_gives_the_reason(seeded, store, worker):
    seeded.post("/v1/drifts", json={"scan_id": "example"})
    detail = "the 60 views stand 6 degrees apart"
    store.jobs.fail(worker.claim(), Failure(kind=FailureKind.INPUT, code="sparse-views", detail=detail))
    assert f"Could not be seen: {detail}" in drift_line(cards(seeded)[1])


def test_names_and_reasons_are_escaped(seeded, newest):
    newest(comparison=comparison(within=False))
    page = seeded.get("/").text
    assert "Line &lt;2&gt;" in page
    assert "0.75 mm &lt;RMS&gt;" in page
    assert "<2>" not in page
    assert "<RMS>" not in page


def test_the_buttons_accept_and_roll_back(seeded, newest):
    newer = newest(comparison=comparison(within=False))
    forms = re.findall(r'action="([^"]+)"', seeded.get("/").text)
    assert forms == [f"/operator/activate/{newer}"]
    assert seeded.post(forms[0]).headers["Location"] == "/"
    assert seeded.get("/v1/scanners/example").json()["active_calibration_id"] == newer
    assert badge(cards(seeded)[1]) == "In tolerance"
    assert re.findall(r'action="([^"]+)"', seeded.get("/").text) == ["/operator/activate/example"]


def test_only_the_newest_activation_is_marked_as_the_active_one(seeded, store, newest):
    newer = newest()
    for identifier in (newer, "example"):
        store.calibrations.activate(identifier, "by hand")
    _, *entries = cards(seeded)[1].split("<li>")
    assert ["<em>active</em>" in entry for entry in entries] == [True, False, False]
    # An earlier activation of what is active already has nothing to roll back to.
    assert [re.findall(r'action="([^"]+)"', entry) for entry in entries] == [[], [f"/operator/activate/{newer}"], []]


def test_another_site_cannot_press_them(seeded):
    assert seeded.post("/operator/activate/example", headers={"Origin": "http://evil.example"}).status_code == 403
