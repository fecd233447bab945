"""What is newest of each scanner, on each database."""

import pytest

from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_contracts.drifts import DriftAsk
from sawmill_contracts.scanners import ScannerSpec
from sawmill_platform.contracts.jobs import Failure, FailureKind

pytestmark = pytest.mark.slow


@pytest.mark.dialect
def test_each_scanner_has_what_is_newest_of_it(store, scanner, ready_scan, finish):
    other = store.scanners.create(ScannerSpec(name="Line 9", constants=scanner.constants))
    ask = CalibrationAsk(scan_id=ready_scan.id, phantom_id="l-shape", activate=True)
    store.calibrations.accept(ask, identifier="first")
    finish(store)
    saw = store.drifts.accept(DriftAsk(scan_id=ready_scan.id))
    finish(store)
    drift = store.drifts.accept(DriftAsk(scan_id=ready_scan.id))
    store.jobs.fail(store.jobs.claim("test"), Failure(kind=FailureKind.INPUT, code="no-log", detail="none"))
    store.calibrations.accept(ask, identifier="second")
    store.jobs.fail(store.jobs.claim("test"), Failure(kind=FailureKind.INPUT, code="phantom-not-seen", detail="none"))
    store.calibrations.accept(ask, identifier="third")

    new, seen = sorted(store.overviews.read(), key=lambda each: each.scanner.name == scanner.name)
    assert (seen.ended_id, seen.succeeded_id) == ("second", "first")
    assert (seen.drift_id, seen.seen_id) == (drift.id, saw.id)
    assert (seen.scan_id, seen.calibrating, seen.scanner.active_calibration_id) == (ready_scan.id, True, "first")
    assert new == (store.scanners.get(other.id), None, None, None, None, None, False)
    assert store.overviews.read(scanner_id=other.id) == [new]
    assert store.calibrations.several(["first", "nothing"]) == {"first": store.calibrations.get("first")}
