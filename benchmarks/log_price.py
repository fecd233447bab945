"""The price of one log of a line: processor seconds of its jobs, and bytes on the disk.

The jobs' own functions run in this process, on a store in a temporary folder: an attempt is forked from a process that
has imported everything and has its kernels, so neither is a part of the price.
"""

import tempfile
from contextlib import closing
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from line_day import CELLS, VIEWS
from scanners import SCANNER
from scans import TRUE_THETA
from waiting_job import do_waiting_job

from sawmill_contracts import kinds
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.reconstructions import ReconstructionRequest
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store
from sawmill_vocabulary import DataKind, ReconstructionMethod
from sawmill_worker.jobs.running import warm_up

FEW = ReconstructionMethod.TOTAL_VARIATION
FEW_ROWS = (32, 96)
UNLIMITED = 2**40
PHOTONS, DARK = 40_000.0, 200.0


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


def make_counts(path: Path, rows: int) -> None:
    """Write 20 views of a round log with a knot as NXtomo, uint16, with a dark and a flat field."""
    rng, across, turn = (
        np.random.default_rng(4),
        np.linspace(-1.0, 1.0, CELLS),
        (np.arange(VIEWS) + 0.5) * 360.0 / VIEWS,
    )
    log = 10.0 * np.sqrt(np.clip(0.4**2 - across**2, 0.0, None))
    along = 1.0 + np.sin(np.arange(rows) / 7.0)[:, None]
    with h5py.File(path, "w") as file:
        entry = file.create_group("entry")
        entry["definition"] = "NXtomo"
        data = entry.create_dataset("instrument/detector/data", (2 + VIEWS, rows, CELLS), np.uint16)
        entry["instrument/detector/image_key"] = [2, 1] + [0] * VIEWS
        entry["instrument/detector/x_pixel_size"] = SCANNER.detector_pitch_mm
        entry["instrument/detector/x_pixel_size"].attrs["units"] = "mm"
        entry["sample/rotation_angle"] = np.concatenate([np.zeros(2), turn])
        entry["sample/rotation_angle"].attrs["units"] = "deg"
        data[0], data[1] = DARK, PHOTONS + DARK
        for view, angle in enumerate(np.radians(turn), 2):
            knot = np.sqrt(np.clip(0.05**2 - (across - 0.1 * np.cos(angle)) ** 2, 0.0, None))
            image = (log + along * knot + 0.01 * rng.standard_normal((rows, CELLS))).astype(np.float32)
            data[view] = (PHOTONS * np.exp(-image) + DARK).astype(np.uint16)


def _scan(store: Store, file: Path, rows: int) -> tuple[str, float, int]:
    """Store a scan; return its id, the processor seconds of reading it, and its file's bytes."""
    make_counts(file, rows)
    scanner = store.scanners.create(ScannerSpec(name="line", constants=ScannerConstants(**vars(SCANNER))))
    with file.open("rb") as content:
        received = store.files.receive(iter(lambda: content.read(2**20), b""), max_bytes=UNLIMITED)
    scan = store.scans.accept(ScanSpec(scanner_id=scanner.id, data=DataKind.COUNTS), received)
    return scan.id, do_waiting_job(store, kinds.INGEST).processor_s, received.size_bytes


def _reconstructed(store: Store, scan_id: str, method: ReconstructionMethod, rows: int) -> tuple[str, float]:
    ask = ReconstructionRequest(scan_id=scan_id, theta=TRUE_THETA, method=method, rows=f"0:{rows}")
    return store.reconstructions.accept(ask).id, do_waiting_job(store, kinds.RECONSTRUCT).processor_s
