"""What calibrations and drift checks leave for charts, on both databases, and what an upgrade fills in."""

import itertools
import math
from datetime import UTC, datetime, timedelta

import pytest
from results import comparison
from sqlalchemy import insert

from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.drifts import DriftRequest
from sawmill_contracts.measurements import MeasurementKind
from sawmill_platform.errors import Invalid, NotFound
from sawmill_store.drift.measurements import MOST_READ
from sawmill_store.mill_tables import MeasurementRow

BEFORE = datetime(2026, 1, 1, tzinfo=UTC)
MOVED = comparison(0.75, calibration_id="first")


@pytest.fixture
def measured(store, ready_scan, finish):
    store.calibrations.accept(CalibrationRequest(scan_id=ready_scan.id, activate=True), identifier="first")
    finish(store)
    store.calibrations.accept(CalibrationRequest(scan_id=ready_scan.id), identifier="second")
    finish(store, comparison=MOVED)
    store.drifts.accept(DriftRequest(scan_id=ready_scan.id), identifier="check")
    finish(store)


@pytest.mark.usefixtures("measured")
def test_each_that_succeeds_leaves_a_row_with_what_it_measured(store, scanner):
    check, second, first = store.measurements.page(scanner.id).items
    assert [(one.kind, one.subject_id, one.against_id) for one in (check, second, first)] == [
        ("drift", "check", "first"),
        ("calibration", "second", "first"),
        ("calibration", "first", None),
    ]
    job = store.jobs.get(store.calibrations.get("second").job_id)
    assert abs(second.at - job.finished_at) < timedelta(seconds=1)  # the two are read from the clock one after another
    assert (second.ray_change_mm, second.ray_change_tolerance_mm, second.within_tolerance) == (0.75, 0.5, False)
    assert (second.cor_column_mm, second.cor_column_change_mm, second.tilt_change_deg) == (-209.1, -1.25, 0.05)
    assert (second.verdict, second.gain, second.ray_error_upper_95_mm) == ("pass", 1.0, 0.04)
    assert (check.ray_change_mm, check.ray_change_tolerance_mm, check.within_tolerance) == (0.01, 0.5, True)
    assert check.tilt_deg == pytest.approx(math.degrees(-0.083))
    assert check.tilt_change_deg == pytest.approx(math.degrees(0.1))
    assert (check.source_distance_mm, check.gain, check.verdict) == (None, None, None)
    assert (second.cor_column_standard_deviation_mm, second.source_to_detector_standard_deviation_mm) == (0.1, 0.1)
    assert second.tilt_standard_deviation_deg == pytest.approx(math.degrees(0.1))
    changes = (first.ray_change_mm, first.within_tolerance, first.cor_column_change_mm, first.tilt_change_deg)
    assert changes == (None, None, None, None)


def test_what_fails_measures_nothing(store, scanner, ready_scan, refuse):
    store.calibrations.accept(CalibrationRequest(scan_id=ready_scan.id))
    refuse()
    assert store.measurements.page(scanner.id).items == []


@pytest.mark.dialect
@pytest.mark.usefixtures("measured")
def test_they_come_in_pages_from_a_time_on_and_in_bulk(store, scanner):
    page = store.measurements.page(scanner.id, limit=2)
    rest = store.measurements.page(scanner.id, after=page.next, limit=2)
    assert [one.subject_id for one in (*page.items, *rest.items)] == ["check", "second", "first"]
    assert rest.next is None
    since = page.items[1].at
    assert [one.subject_id for one in store.measurements.page(scanner.id, since=since).items] == ["check", "second"]
    until = page.items[0].at
    movements = store.measurements.movements(since, until)
    assert [one.subject_id for one in movements[scanner.id]] == ["second", "check"]
    assert store.measurements.movements_of(scanner.id, since, until) == (movements[scanner.id], 2)
    assert store.measurements.movements_of("other", BEFORE, until) == ([], 0)
    with pytest.raises(NotFound, match="no scanner 'other'"):
        store.measurements.page("other")
    with pytest.raises(Invalid, match="after must be the next"):
        store.measurements.page(scanner.id, after="x")


@pytest.mark.dialect
def test_of_very_many_a_chart_reads_the_newest_and_the_farthest_of_each_part_of_the_time(store, scanner):
    start, step, many = BEFORE, timedelta(minutes=5), 3000
    same = {"scanner_id": scanner.id, "cor_column_mm": -209.0, "tilt_rad": -0.07, "source_to_detector_mm": 1600.0}
    rows = [
        same
        | {
            "at": start + number * step,
            "kind": MeasurementKind.CALIBRATION if number % 100 == 0 else MeasurementKind.DRIFT,
            "subject_id": f"one-{number}",
            "ray_change_mm": 2.0 if number == 1333 else None if number == 2444 else 0.01,
            "relative_residual": 0.01,
        }
        for number in range(many)
    ]
    with store.database.write() as session:
        for first in range(0, many, 500):  # each within the time that a statement may take on a busy machine
            session.execute(insert(MeasurementRow), rows[first : first + 500])
    found, total = store.measurements.movements_of(scanner.id, start, start + many * step)
    assert store.measurements.movements(start, start + many * step) == {scanner.id: found}, "no more is read"
    names = [one.subject_id for one in found]
    assert total == many
    assert 500 < len(found) <= MOST_READ
    assert [one.at for one in found] == sorted(one.at for one in found)
    assert {"one-1333", "one-2999"} <= {*names}, "the one that moved farthest, and the newest"
    calibrations = [one for one in found if one.kind is MeasurementKind.CALIBRATION]
    assert len(calibrations) == 30, "drift checks crowd no calibration out"
    gaps = [later.at - earlier.at for earlier, later in itertools.pairwise(found)]
    assert max(gaps) <= 2 * many // 500 * step, "each part of the time has one"
    some, number = store.measurements.movements_of(scanner.id, start + 1000 * step, start + 2000 * step)
    assert (len(some), number) == (2000, 2000)
