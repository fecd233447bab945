import pytest

from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_contracts.drifts import DriftAsk
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.errors import Conflict, NotFound
from sawmill_vocabulary import DataKind


@pytest.fixture
def calibration(store, ready_scan, finish):
    accepted = store.calibrations.accept(CalibrationAsk(scan_id=ready_scan.id, activate=True))
    finish(store)
    return store.calibrations.get(accepted.id)


def test_a_look_at_drift_takes_the_active_calibration(store, ready_scan, calibration, finish):
    asked = store.drifts.accept(DriftAsk(scan_id=ready_scan.id, rows="0:1"))
    assert (asked.state, asked.calibration_id, asked.options.rows) == ("queued", calibration.id, "0:1")
    finish(store)
    done = store.drifts.get(asked.id)
    assert (done.state, done.result.within_tolerance) == ("succeeded", True)


def test_without_an_active_calibration_one_must_be_named(store, ready_scan):
    with pytest.raises(Conflict, match=r"has no active calibration: name one as calibration_id$"):
        store.drifts.accept(DriftAsk(scan_id=ready_scan.id))


def test_it_waits_for_its_scan_and_its_calibration(store, upload, finish):
    scan = upload(store)
    calibration = store.calibrations.accept(CalibrationAsk(scan_id=scan.id))
    asked = store.drifts.accept(DriftAsk(scan_id=scan.id, calibration_id=calibration.id))
    for expected in (scan.job_id, calibration.job_id):
        assert asked.job_id not in store.jobs.queued_job_ids()
        assert finish(store).job_id == expected
    assert finish(store).job_id == asked.job_id


def test_another_scanner_s_calibration_is_refused(store, scanner, calibration):
    other = store.scanners.create(ScannerSpec(name="Line 3", constants=scanner.constants))
    spec = ScanSpec(scanner_id=other.id, data=DataKind.COUNTS)
    scan = store.scans.accept(spec, store.files.receive([b"scan"], max_bytes=10))
    with pytest.raises(Conflict, match=f"is of scanner '{scanner.id}', but scan"):
        store.drifts.accept(DriftAsk(scan_id=scan.id, calibration_id=calibration.id))


def test_a_taken_id_and_an_unknown_one_are_reported(store, ready_scan, calibration):
    ask = DriftAsk(scan_id=ready_scan.id, calibration_id=calibration.id)
    store.drifts.accept(ask, identifier="example")
    with pytest.raises(Conflict, match="there is a drift 'example' already"):
        store.drifts.accept(ask, identifier="example")
    with pytest.raises(NotFound, match="there is no drift 'other'"):
        store.drifts.get("other")


def test_a_scan_stays_until_its_drift_is_known_and_may_go_then(store, ready_scan, calibration, finish):
    asked = store.drifts.accept(DriftAsk(scan_id=ready_scan.id, calibration_id=calibration.id))
    with pytest.raises(Conflict, match=f"is needed by job '{asked.job_id}'"):
        store.scans.delete(ready_scan.id)
    finish(store)
    store.scans.delete(ready_scan.id)
    assert store.drifts.get(asked.id).scan_id == ready_scan.id


def test_they_are_listed_by_scanner_scan_and_state(store, scanner, ready_scan, calibration, finish):
    ask = DriftAsk(scan_id=ready_scan.id, calibration_id=calibration.id)
    first = store.drifts.accept(ask)
    finish(store)
    second = store.drifts.accept(ask)
    assert [item.id for item in store.drifts.page(scanner_id=scanner.id).items] == [second.id, first.id]
    assert [item.id for item in store.drifts.page(state=JobState.QUEUED).items] == [second.id]
    assert [item.id for item in store.drifts.page(scan_id=ready_scan.id, limit=1).items] == [second.id]
    assert store.drifts.page(scan_id="other").items == []
