"""The price of one log of a line: processor seconds of its jobs, and bytes on the disk.

The jobs' own functions run in this process, on a store in a temporary folder: an attempt is forked from a process that
has imported everything and has its kernels, so neither is a part of the price.
"""

import tempfile
from contextlib import closing
from pathlib import Path
from typing import Any

from line_day import VIEWS
from memory import make_counts
from scanners import SCANNER
from scans import TRUE_THETA
from waiting_job import do_waiting_job

from sawmill_contracts import job_kinds
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.reconstructions import ReconstructionAsk
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store
from sawmill_vocabulary import DataKind, ReconstructionMethod
from sawmill_worker.jobs.running import warm_up

FEW = ReconstructionMethod.TOTAL_VARIATION
FEW_ROWS = (32, 96)
UNLIMITED = 2**40


def price_of_a_log(rows: int, few_rows: tuple[int, int], few: ReconstructionMethod) -> dict[str, Any]:
    """Measure processor seconds and bytes of a log.

    Parameters
    ----------
    rows
        Rows of the log; `fbp` reconstructs all of them.
    few_rows
        Two numbers of rows that are reconstructed by another method: from their difference follows what a slice costs,
        and what is chosen once for a log.
    few
        The other method, one for few views.
    """
    with tempfile.TemporaryDirectory(prefix="sawmill-log-") as name:
        settings = StorageSettings(data_folder=Path(name) / "data", database_url=None)
        with closing(Store.open(settings)) as store:
            warm_up()
            scan_id, read_s, sent_bytes = _scan(store, Path(name) / "log.nxs", rows)
            volume_id, fbp_s = _reconstructed(store, scan_id, ReconstructionMethod.FBP, rows)
            fewer, more = few_rows
            fewer_s, more_s = (_reconstructed(store, scan_id, few, number)[1] for number in few_rows)
            slice_s = (more_s - fewer_s) / (more - fewer)
            return {
                "rows": rows,
                "upload_bytes": sent_bytes,
                "scan_bytes": store.files.scan(scan_id).stat().st_size,
                "volume_bytes": store.files.volume(volume_id).stat().st_size,
                "read_processor_s": read_s,
                "fbp_processor_s": fbp_s,
                "few_method": few.value,
                "few_processor_s_a_slice": slice_s,
                "few_processor_s_once": fewer_s - fewer * slice_s,
            }


def _scan(store: Store, file: Path, rows: int) -> tuple[str, float, int]:
    """Store a scan; return its id, the processor seconds of reading it, and its file's bytes."""
    make_counts(file, rows, number=VIEWS, fields=1)
    scanner = store.scanners.create(ScannerSpec(name="line", constants=ScannerConstants(**vars(SCANNER))))
    with file.open("rb") as content:
        received = store.files.receive(iter(lambda: content.read(2**20), b""), max_bytes=UNLIMITED)
    scan = store.scans.accept(ScanSpec(scanner_id=scanner.id, data=DataKind.COUNTS), received)
    return scan.id, do_waiting_job(store, job_kinds.INGEST).processor_s, received.size_bytes


def _reconstructed(store: Store, scan_id: str, method: ReconstructionMethod, rows: int) -> tuple[str, float]:
    ask = ReconstructionAsk(scan_id=scan_id, theta=TRUE_THETA, method=method, rows=f"0:{rows}")
    return store.reconstructions.accept(ask).id, do_waiting_job(store, job_kinds.RECONSTRUCT).processor_s
