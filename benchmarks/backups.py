"""Seconds of a backup, of an unchanged one after it, of its check and of a restore, with many small files.

    python benchmarks/backups.py [--files N] [--file-bytes N] [--folder FOLDER] [--results FOLDER]

The data folder and the backups are made below FOLDER, on one disk. Each upload is a scan that has been refused, so that
it has two rows and an event. A run with 58 000 files of 10 kB writes `benchmarks/results/backups.json`, from which
docs/do/backup.md has a figure of it. Another one only prints, unless `--results` names a folder.
"""

import argparse
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar

from measurement import RESULTS, Measurement, reference_s
from sqlalchemy import insert

from sawmill_contracts import job_kinds
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanState
from sawmill_platform.backups.checking import check_backup
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.jobs import Failure, FailureKind, JobState
from sawmill_platform.database.database import Database
from sawmill_platform.database.engines import make_engine
from sawmill_platform.database.tables import EventRow, JobRow
from sawmill_platform.settings import StorageSettings
from sawmill_store.backups import restore, take_backup
from sawmill_store.mill_tables import ScanRow
from sawmill_store.store import Store

FILES, FILE_BYTES, NEW = 58_000, 10_000, 10
PARTS = {
    "first": "the first backup",
    "unchanged": "the next one, nothing is new",
    "ten_new": "the next one, ten files are new",
    "check": "`restore --check`",
    "restore": "`restore`",
    "copy": "a plain copy, to compare",
}
BATCH = 5000
FAILURE = Failure(kind=FailureKind.INPUT, code="unknown-format", detail="no reader knows the file")

T = TypeVar("T")


def add_scans(settings: StorageSettings, first: int, number: int, file_bytes: int) -> None:
    """Write uploads and the rows of scans that were refused, without the price of asking for each."""
    database = Database(make_engine(settings.url))
    start = datetime.now(UTC) - timedelta(seconds=first + number)
    with closing(SimpleNamespace(close=database.engine.dispose)):
        for begin in range(first, first + number, BATCH):
            names = [f"scan-{each:06}" for each in range(begin, min(begin + BATCH, first + number))]
            rows = [_rows(name, start + timedelta(seconds=each), file_bytes) for each, name in enumerate(names, begin)]
            with database.write() as session:
                for table, of_table in zip((JobRow, ScanRow, EventRow), zip(*rows, strict=True), strict=True):
                    session.execute(insert(table), list(of_table))
            for name in names:
                path = settings.data_folder / "uploads/scans" / name / "original"
                path.parent.mkdir(parents=True)
                path.write_bytes(os.urandom(file_bytes))


def _rows(name: str, at: datetime, file_bytes: int) -> tuple[dict[str, Any], ...]:
    job = {
        "id": f"job-{name}",
        "created_at": at,
        "kind": job_kinds.INGEST,
        "state": JobState.FAILED,
        "subject_id": name,
        "attempt": 1,
        "failure": FAILURE.model_dump(mode="json"),
        "finished_at": at,
    }
    scan = {
        "id": name,
        "created_at": at,
        "scanner_id": "line",
        "spec": {"data": "counts"},
        "state": ScanState.REFUSED,
        "reason": FAILURE.detail,
        "size_bytes": file_bytes,
        "sha256": "0" * 64,
        "job_id": job["id"],
    }
    event = {
        "at": at,
        "what": event_kinds.FAILED,
        "scanner_id": "line",
        "subject": "scan",
        "subject_id": name,
        "job_id": job["id"],
        "attempt": 1,
        "detail": job["failure"],
    }
    return job, scan, event


def ignore(_progress: object) -> None:
    """Show nothing."""


def measured(values: dict[str, float], name: str, do: Callable[[], T]) -> T:
    """Run the work, print its seconds, and return its result."""
    os.sync()
    clock_s, processor_s = time.perf_counter(), time.process_time()
    done = do()
    values[f"{name}_processor_s"] = time.process_time() - processor_s
    values[f"{name}_clock_s"] = time.perf_counter() - clock_s
    print(f"{name:10} {values[f'{name}_processor_s']:9.2f} {values[f'{name}_clock_s']:9.2f}", flush=True)
    return done


def measure(folder: Path, files: int, file_bytes: int) -> dict[str, float]:
    """Make a data folder, and measure."""
    settings = StorageSettings(data_folder=folder / "data", database_url=None)
    constants = ScannerConstants(source_to_cor_mm=859.46, num_detector_pixels=768, detector_pitch_mm=1.5)
    with closing(Store.open(settings)) as store:
        store.scanners.create(ScannerSpec(name="line", constants=constants), scanner_id="line")
    add_scans(settings, 0, files, file_bytes)
    disk = folder / "disk"
    disk.mkdir()
    values: dict[str, float] = {"files": files, "file_bytes": file_bytes}
    print("seconds    processor     clock")
    measured(values, "first", lambda: take_backup(settings, disk, ignore))
    measured(values, "unchanged", lambda: take_backup(settings, disk, ignore))
    add_scans(settings, files, NEW, file_bytes)
    taken = measured(values, "ten_new", lambda: take_backup(settings, disk, ignore))
    measured(values, "check", lambda: check_backup(taken.path, ignore))
    elsewhere = StorageSettings(data_folder=folder / "elsewhere", database_url=None)
    measured(values, "restore", lambda: restore(taken.path, elsewhere, ignore))
    measured(values, "copy", lambda: shutil.copytree(settings.data_folder, folder / "copy"))
    return values


def table(values: dict[str, float]) -> str:
    """Write the seconds as a table of Markdown."""
    rows = [
        f"| {words} | {values[f'{part}_processor_s']:.1f} | {values[f'{part}_clock_s']:.1f} |"
        for part, words in PARTS.items()
    ]
    return "\n".join(("| what | processor, s | clock, s |", "|---|---|---|", *rows))


def main(arguments: list[str] | None = None, reference: Callable[[], float] = reference_s) -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=FILES)
    parser.add_argument("--file-bytes", type=int, default=FILE_BYTES)
    parser.add_argument("--folder", type=Path, help="on the disk that is measured; by default that of temporary files")
    parser.add_argument("--results", type=Path, help="where results are written, also those of another size")
    chosen = parser.parse_args(arguments)
    complete = (chosen.files, chosen.file_bytes) == (FILES, FILE_BYTES)
    results = chosen.results or (RESULTS if complete else None)
    measurement = Measurement.begin("worker/sawmill_platform/backups", reference=reference)
    with tempfile.TemporaryDirectory(prefix="sawmill-backups-", dir=chosen.folder) as folder:
        values = measure(Path(folder), chosen.files, chosen.file_bytes)
    if results is not None:
        measurement.write({"backups": values | {"table": table(values)}}, results)


if __name__ == "__main__":
    main()
