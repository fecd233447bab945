"""Files that rows name and somebody has taken away."""

import pytest

from sawmill_contracts import job_kinds
from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_contracts.reconstructions import ReconstructionAsk
from sawmill_platform.backups import named_files

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
        store.files.results(job_kinds.CALIBRATE, calibration.id) / "result.h5",
        store.files.results(job_kinds.RECONSTRUCT, reconstruction.id) / "volume.h5",
        store.files.results(job_kinds.INGEST, scan.id) / "scan.h5",
        *sorted(store.files.upload(job_kinds.INGEST, one.id) for one in (scan, unread)),
    ]
    for file in files[:3]:
        file.touch()
    assert store.lost_files() == []
    for file in files:
        file.unlink()
    assert store.lost_files() == [file.relative_to(store.files.folder).as_posix() for file in files]


def test_what_is_deleted_meanwhile_is_not_lost(store, ready_scan, monkeypatch):
    named_by = named_files.named_by

    def deleted_after_the_look(connection, folders, tables):
        named = named_by(connection, folders, tables)
        monkeypatch.undo()
        store.scans.delete(ready_scan.id)
        return named

    monkeypatch.setattr(named_files, "named_by", deleted_after_the_look)
    assert store.lost_files() == []
