"""Files that rows name and somebody has taken away."""

import pytest
from sqlalchemy import event

from sawmill_contracts import kinds
from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_contracts.reconstructions import ReconstructionAsk

pytestmark = pytest.mark.slow


def test_uploads_and_results_without_their_file_are_lost(store, upload, finish):
    scan = upload(store)
    finish(store)
    calibration = store.calibrations.accept(CalibrationAsk(scan_id=scan.id))
    finish(store)
    reconstruction = store.reconstructions.accept(ReconstructionAsk(scan_id=scan.id, calibration_id=calibration.id))
    finish(store)
    unread = upload(store)
    files = [
        store.files.results(kinds.CALIBRATE, calibration.id) / "result.h5",
        store.files.results(kinds.RECONSTRUCT, reconstruction.id) / "volume.h5",
        store.files.results(kinds.INGEST, scan.id) / "scan.h5",
        *sorted(store.files.upload(kinds.INGEST, one.id) for one in (scan, unread)),
    ]
    for file in files[:3]:
        file.touch()
    assert store.lost_files() == []
    for file in files:
        file.unlink()
    assert store.lost_files() == [file.relative_to(store.files.folder).as_posix() for file in files]


def test_what_is_deleted_meanwhile_is_not_lost(store, ready_scan):
    """The transaction that has read the rows shows them as they were."""
    deleted = []

    def delete_once(*given):
        if "FROM scans" in given[2] and not deleted:
            deleted.append(given[2])
            store.scans.delete(ready_scan.id)

    event.listen(store.database.engine, "after_cursor_execute", delete_once)
    assert store.lost_files() == []
    assert len(deleted) == 1
