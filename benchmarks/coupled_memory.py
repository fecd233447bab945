"""The largest memory and the seconds of the job that reconstructs a whole log by coupled total variation.

    python benchmarks/coupled_memory.py [--rows 2500] [--views 20] [--folder FOLDER]

A log of VIEWS x ROWS x 768 line integrals (`memory.py`) is read by the ingest's job and reconstructed by the
reconstruction's, `total_variation` coupled by a given weight, in this process: its largest memory (VmHWM) before and
after the reconstruction, and its seconds by the clock and of processors.

Last comes an estimate for more cores, by Amdahl's law and from processor seconds alone, so that what else the machine
does counts little. The job's own thread does all that is serial and its share of what is parallel; together they give
both. The time to choose the weight is part of it, once a log. Memory is taken to keep pace with the cores.
"""

import argparse
import os
import tempfile
from pathlib import Path

from measurement import Measurement
from memory import make_npy
from numba import get_num_threads
from scanners import SCANNER
from waiting_job import Done, do_waiting_job

from sawmill_contracts import job_kinds
from sawmill_contracts.geometry import GivenTheta, ScannerConstants
from sawmill_contracts.reconstructions import ReconstructionAsk
from sawmill_contracts.scanners import ScannerSpec, Tolerances
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.attempts.limits import peak_memory_bytes
from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store
from sawmill_vocabulary import DataKind, ReconstructionMethod

# The log of `memory.py` is in the middle of the detector.
THETA = GivenTheta(
    initial_angle_rad=0.0, detector_to_cor_mm=714.68, source_shift_mm=0.0, detector_shift_mm=0.0, detector_tilt=0.0
)
# The coupling chosen for simulated logs; for this log none would be chosen.
COUPLING = "0.4"
# Time between two logs at a mill, and a server's number of cores.
LOG_EVERY_S, MANY_CORES = 29.0, 16
ROWS = 2500


def largest_gb() -> float:
    """Return VmHWM of this process."""
    return 1e-9 * peak_memory_bytes()


def shared_s(done: Done) -> tuple[float, float]:
    """Return the processor seconds that more cores do not shorten, and those shared; from two threads or more."""
    threads = get_num_threads()
    parallel_s = (done.processor_s - done.own_thread_s) * threads / (threads - 1)
    return done.processor_s - parallel_s, parallel_s


def main() -> None:
    """Print the lines."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=ROWS, help="of the detector")
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--folder", type=Path, help="where the temporary folder is made")
    options = parser.parse_args()
    measurement = Measurement.begin(
        "worker/sawmill_tomography/reconstruction", "worker/sawmill_calibration/reconstruction"
    )
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        folder = Path(name)
        store = Store.open(StorageSettings(data_folder=folder / "data", database_url=None))
        spec = ScannerSpec(name="scanner", constants=ScannerConstants(**vars(SCANNER)), tolerances=Tolerances())
        path, step = folder / "log.npy", 360.0 / options.views
        make_npy(path, options.rows, options.views)
        given = ScanSpec(
            scanner_id=store.scanners.create(spec).id,
            data=DataKind.LINE_INTEGRALS,
            angles_deg=f"{0.5 * step}:{step}",
        )
        with path.open("rb") as file:
            received = store.files.receive(iter(lambda: file.read(2**20), b""), max_bytes=2**40)
        scan = store.scans.accept(given, received)
        do_waiting_job(store, job_kinds.INGEST)
        print(
            f"{options.views} views x {options.rows} rows, read: {largest_gb():.2f} GB at most",
            flush=True,
        )
        ask = ReconstructionAsk(
            scan_id=scan.id, theta=THETA, method=ReconstructionMethod.TOTAL_VARIATION, coupling=COUPLING
        )
        store.reconstructions.accept(ask)
        done = do_waiting_job(store, job_kinds.RECONSTRUCT)
        largest = largest_gb()
        print(
            f"reconstructed {done.result['shape']}: {largest:.2f} GB at most, {done.clock_s:.0f} s by "
            f"the clock, {done.processor_s:.0f} s of processors, {os.cpu_count()} cores; {done.result['method']}"
        )
        store.close()
    serial_s, parallel_s = shared_s(done)
    many_s = serial_s + parallel_s / MANY_CORES
    print(
        f"serial {serial_s:.1f} s of {done.processor_s:.1f} s of processors; estimate for {MANY_CORES} cores: "
        f"{many_s:.1f} s, where a log comes every {LOG_EVERY_S:.0f} s"
    )
    if options.rows == ROWS:
        found = {"clock_s": done.clock_s, "processor_s": done.processor_s, "serial_s": serial_s}
        measurement.write({"coupled-log": {**found, "estimate_16_cores_s": many_s, "memory_gb": largest}})


if __name__ == "__main__":
    main()
