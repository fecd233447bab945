"""What a backup, one after it, its check and a restore take: a data folder of many files, on the disk of this folder.

python benchmarks/backups.py [--files N] [--folder FOLDER]; the table is that of docs/backup.md.
"""

import argparse
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import TypeVar

from sawmill_worker.contracts.geometry import ScannerConstants
from sawmill_worker.contracts.scanners import ScannerSpec
from sawmill_worker.contracts.scans import ScanSpec
from sawmill_worker.storage.backups.checking import check_backup
from sawmill_worker.storage.backups.restoring import restore
from sawmill_worker.storage.backups.taking import Taken, take_backup
from sawmill_worker.storage.settings import StorageSettings
from sawmill_worker.storage.store import Store
from sawmill_worker.vocabulary import DataKind

FILE_BYTES, NEW = 2_000_000, 10

T = TypeVar("T")


def add_scans(store: Store, number: int) -> None:
    """Accept uploads that nobody reads."""
    constants = ScannerConstants(source_to_cor_mm=859.46, num_detector_pixels=768, detector_pitch_mm=1.5)
    scanner = store.scanners.create(ScannerSpec(name="line 2", constants=constants))
    for _ in range(number):
        received = store.files.receive([os.urandom(FILE_BYTES)], max_bytes=FILE_BYTES)
        store.scans.accept(ScanSpec(scanner_id=scanner.id, data=DataKind.COUNTS), received)


def timed(what: str, do: Callable[[], T]) -> T:
    """Do it, and print a row of the table."""
    os.sync()
    began = time.perf_counter()
    done = do()
    copied = f"{done.copied_bytes / 1e6:.0f} MB" if isinstance(done, Taken) else ""
    print(f"| {what} | {time.perf_counter() - began:.1f} | {copied} |")
    return done


def main() -> None:
    """Make the folder, and measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=1000)
    parser.add_argument("--folder", type=Path, default=None)
    asked = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="sawmill-backups-", dir=asked.folder))
    settings = StorageSettings(data_folder=folder / "data", database_url=None)
    (folder / "disk").mkdir()

    def silent(_progress: object) -> None:
        """Nobody looks."""

    try:
        with closing(Store.open(settings)) as store:
            add_scans(store, asked.files)
            timed("the first backup", lambda: take_backup(settings, folder / "disk", silent))
            add_scans(store, NEW)
            taken = timed("the second one", lambda: take_backup(settings, folder / "disk", silent))
        timed("`restore --check`", lambda: check_backup(taken.path, silent))
        elsewhere = StorageSettings(data_folder=folder / "elsewhere", database_url=None)
        timed("`restore`", lambda: restore(taken.path, elsewhere, silent))
        timed("a plain copy, to compare", lambda: shutil.copytree(settings.data_folder, folder / "copy"))
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
