"""Make `data_0_1_0.tar.xz`, a data folder of version 0.1.0, with that version's own code.

    git worktree add FOLDER 9df6f76
    PYTHONPATH=FOLDER python tests/support/make_data_0_1_0.py

Commit 9df6f76 is the last of 2026-11-20, the day of 0.1.0; its packages are called `service` and `worker`. The folder
holds its examples on a scanner of 192 cells, a second calibration, one that failed, one that was cancelled, and a plan
that waits. Uploads and the files of the second calibration and reconstruction are left out: the archive stays below
1 MB.
"""

import tarfile
import tempfile
import threading
from functools import partial
from pathlib import Path

ARCHIVE = Path(__file__).with_name("data_0_1_0.tar.xz")
LEFT_OUT = {
    "./sawmill.db.lock",
    "./calibrations/second",
    "./examples/log-with-phantom.h5",
    "./examples/phantom-scan.npz",
    "./reconstructions/example-sparse",
    "./uploads/scans",
}


def fill(data: Path) -> None:
    """Fill a data folder, and do all of its jobs but the last."""
    from worker import examples  # noqa: PLC0415 - these are of version 0.1.0
    from worker.contracts.calibrations import CalibrationAsk  # noqa: PLC0415
    from worker.contracts.plans import PlanAsk  # noqa: PLC0415
    from worker.execution.runner import Runner  # noqa: PLC0415
    from worker.execution.settings import ExecutionSettings  # noqa: PLC0415
    from worker.storage.settings import StorageSettings  # noqa: PLC0415
    from worker.storage.store import Store  # noqa: PLC0415
    from worker.tomography.geometry import Scanner  # noqa: PLC0415

    examples.SCANNER = Scanner(source_to_cor_mm=859.46, num_detector_pixels=192, detector_pitch_mm=6.011458332)
    examples.PHANTOM_ROWS, examples.LOG_ROWS = 1, 1
    examples.mill_slices = partial(examples.mill_slices, log_rows=1)
    store = Store.open(StorageSettings(data_folder=data, database_url=None))
    examples.seed_examples(store)
    store.calibrations.accept(CalibrationAsk(scan_id="example", views=60, activate=True), calibration_id="second")
    store.calibrations.accept(CalibrationAsk(scan_id="example", phantom_id="example-spare"), calibration_id="failed")
    runner = Runner(store, ExecutionSettings(broker_url=None), threading.Event())
    while runner.run_next() is not None:
        pass
    runner.close()
    store.calibrations.activate("example", reason="back to the first")
    cancelled = store.calibrations.accept(CalibrationAsk(scan_id="example"), calibration_id="cancelled")
    store.jobs.request_cancel(cancelled.job_id)
    store.plans.accept("l-shape", PlanAsk(scanner_id="example", views=20), plan_id="queued")
    store.close()


def pack(data: Path) -> None:
    """Write the archive, without the names of this machine's users."""

    def chosen(entry: tarfile.TarInfo) -> tarfile.TarInfo | None:
        entry.uid = entry.gid = 0
        entry.uname = entry.gname = ""
        return None if entry.name in LEFT_OUT else entry

    with tarfile.open(ARCHIVE, "w:xz", preset=9) as archive:
        archive.add(data, ".", filter=chosen)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        fill(Path(folder, "data"))
        pack(Path(folder, "data"))
