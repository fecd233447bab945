import pytest

from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_contracts.drifts import DriftAsk
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.errors import Conflict
from sawmill_vocabulary import DataKind


@pytest.fixture
def calibration(store, ready_scan, finish):
    accepted = store.calibrations.accept(CalibrationAsk(scan_id=ready_scan.id, activate=True))
    finish(store)
    return store.calibrations.get(accepted.id)


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
