"""The largest memory of reading and reconstructing a whole log from files of other programs.

    python benchmarks/memory.py [--rows 2500] [--folder FOLDER]

Each file is a log of 360 x ROWS x 768 with noise, made by a separate process in a temporary folder (up to 3 GB and
as much again while it is read; deleted). The command `sawmill reconstruct` and the job that reads an upload each run in
a process of their own, whose largest memory the system tells when it ends.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

import h5py
import numpy as np
import tifffile
from numpy.typing import NDArray
from scanners import SCANNER

from sawmill_contracts import job_kinds
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.scanners import ScannerSpec, Tolerances
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store
from sawmill_vocabulary import DataKind
from sawmill_worker.jobs.attempt import MillAttempt
from sawmill_worker.jobs.running import run

VIEWS, CELLS = 360, SCANNER.num_detector_pixels
FIELDS, PHOTONS, DARK = 10, 40_000.0, 200.0
GEOMETRY = ("--theta=2.55023549,714.683839,319.943788,43.6514375,0.280799451", "--source-to-cor-mm=859.46")
ANGLES_AND_PITCH = ("--angles-deg=0.5:1", f"--detector-pitch-mm={SCANNER.detector_pitch_mm}")


def views(rows: int, number: int = VIEWS) -> Iterator[NDArray[np.float32]]:
    """Yield line integrals (rows, cells) of a round log with a knot that goes round, view by view."""
    rng, across = np.random.default_rng(4), np.linspace(-1.0, 1.0, CELLS)
    log = 2.0 * np.sqrt(np.clip(0.4**2 - across**2, 0.0, None)) * 5.0
    along = 1.0 + np.sin(np.arange(rows) / 7.0)[:, None]
    for angle in (np.arange(number) + 0.5) * 2.0 * np.pi / number:
        knot = np.sqrt(np.clip(0.05**2 - (across - 0.1 * np.cos(angle)) ** 2, 0.0, None))
        yield (log + along * knot + 0.01 * rng.standard_normal((rows, CELLS))).astype(np.float32)


def make_counts(path: Path, rows: int, *, packed: bool = False, number: int = VIEWS, fields: int = FIELDS) -> None:
    """Write NXtomo with dark and flat fields, uint16."""
    keys = [2] * fields + [1] * fields + [0] * number
    with h5py.File(path, "w") as file:
        entry = file.create_group("entry")
        entry["definition"] = "NXtomo"
        shape, level = (len(keys), rows, CELLS), 1 if packed else None
        chunks = (1, rows, CELLS) if packed else None
        data = entry.create_dataset("instrument/detector/data", shape, np.uint16, chunks=chunks, compression=level)
        entry["instrument/detector/image_key"] = keys
        entry["instrument/detector/x_pixel_size"] = SCANNER.detector_pitch_mm
        entry["instrument/detector/x_pixel_size"].attrs["units"] = "mm"
        entry["sample/rotation_angle"] = np.concatenate(
            [np.zeros(2 * fields), (np.arange(number) + 0.5) * 360.0 / number]
        )
        entry["sample/rotation_angle"].attrs["units"] = "deg"
        data[:fields] = DARK
        data[fields : 2 * fields] = PHOTONS + DARK
        for view, image in enumerate(views(rows, number), 2 * fields):
            data[view] = (PHOTONS * np.exp(-image) + DARK).astype(np.uint16)


def make_packed_counts(path: Path, rows: int) -> None:
    """Write counts with each view packed by itself: no row can be read alone."""
    make_counts(path, rows, packed=True)


def make_dataset(path: Path, rows: int) -> None:
    """Write HDF5 with one dataset of line integrals, float32."""
    with h5py.File(path, "w") as file:
        data = file.create_dataset("data", (VIEWS, rows, CELLS), np.float32)
        for view, image in enumerate(views(rows)):
            data[view] = image


def make_tiff(path: Path, rows: int) -> None:
    """Write a TIFF of one page a view, float32."""
    tifffile.imwrite(path, views(rows), shape=(VIEWS, rows, CELLS), dtype=np.float32, metadata=None)


def make_npy(path: Path, rows: int, number: int = VIEWS) -> None:
    """Write NPY, float32."""
    stack = np.lib.format.open_memmap(path, "w+", np.float32, (number, rows, CELLS))
    for view, image in enumerate(views(rows, number)):
        stack[view] = image


FILES: Mapping[str, tuple[DataKind, Callable[[Path, int], None]]] = MappingProxyType(
    {
        "NXtomo, uint16": (DataKind.COUNTS, make_counts),
        "NXtomo, uint16, packed": (DataKind.COUNTS, make_packed_counts),
        "HDF5, float32": (DataKind.LINE_INTEGRALS, make_dataset),
        "TIFF, float32": (DataKind.LINE_INTEGRALS, make_tiff),
        "NPY, float32": (DataKind.LINE_INTEGRALS, make_npy),
    }
)


def ingest(path: Path, kind: DataKind) -> None:
    """Read a file as the job does that follows an upload."""
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        store = Store.open(StorageSettings(data_folder=Path(folder) / "data", database_url=None))
        scanner = ScannerSpec(name="scanner", constants=ScannerConstants(**vars(SCANNER)), tolerances=Tolerances())
        given = ScanSpec(
            scanner_id=store.scanners.create(scanner).id,
            data=kind,
            angles_deg=None if kind is DataKind.COUNTS else "0.5:1",
        )
        store.scans.accept(given, store.files.receive([b"in place of the file"], max_bytes=100))
        (job,) = store.jobs.page(kind=job_kinds.INGEST, limit=1).items
        upload = store.files.upload(job.kind, job.subject_id)
        upload.unlink()
        upload.symlink_to(path)
        output = Path(folder) / "output"
        output.mkdir()
        run(MillAttempt(job, store.jobs.handed_over(job.id), output, report=lambda _: None, announce=lambda _: None))
        store.close()


def reconstruct(path: Path, kind: DataKind) -> tuple[str, ...]:
    """Return the arguments of the command line."""
    reported = () if kind is DataKind.COUNTS else ANGLES_AND_PITCH
    volume = str(path.with_name("volume.h5"))
    return (
        "-m",
        "sawmill_command.commands",
        "reconstruct",
        str(path),
        f"--data={kind}",
        "--method=fbp",
        *reported,
        *GEOMETRY,
        "-o",
        volume,
    )


def watched(*command: str) -> str:
    """Run Python in a separate process; return the seconds and the largest memory."""
    started = time.perf_counter()
    child = subprocess.Popen([sys.executable, *command], stderr=subprocess.DEVNULL)  # noqa: S603 - ourselves
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise SystemExit(child.returncode)
    seconds = time.perf_counter() - started
    return (
        f"{seconds:6.1f} s ({used.ru_utime + used.ru_stime:5.1f} of processors) {used.ru_maxrss * 1024 / 1e9:5.2f} GB"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=2500, help="of the detector")
    parser.add_argument("--folder", type=Path, help="where the temporary folder is made")
    parser.add_argument("--make", help=argparse.SUPPRESS)
    parser.add_argument("--ingest", help=argparse.SUPPRESS)
    parser.add_argument("--path", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.make:
        FILES[options.make][1](options.path, options.rows)
        return
    if options.ingest:
        ingest(options.path, FILES[options.ingest][0])
        return
    print(f"a log of {VIEWS} x {options.rows} x {CELLS}, {4e-9 * VIEWS * options.rows * CELLS:.2f} GB as float32")
    for name, (kind, _) in FILES.items():
        with tempfile.TemporaryDirectory(dir=options.folder) as folder:
            path = Path(folder).resolve() / "log"
            given = ("--path", str(path), "--rows", str(options.rows))
            watched(__file__, "--make", name, *given)
            print(f"  {name:23} sawmill reconstruct {watched(*reconstruct(path, kind))}")
            print(f"  {'':23} upload's job        {watched(__file__, '--ingest', name, *given)}", flush=True)


if __name__ == "__main__":
    main()
