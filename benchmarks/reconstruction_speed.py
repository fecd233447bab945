"""Filtered back-projection compared with ODL and ASTRA, the cost model's fit, and a whole log in bounded memory.

    python benchmarks/reconstruction_speed.py [--no-log]

One slice and ODL's are timed in turns in one process, so that what else the machine does weighs on both. The log is
made on the fly in a temporary folder (3 GB, deleted) and reconstructed as the job does it, in a separate process
whose largest memory is read from outside. A run with the log writes `benchmarks/results/fbp.json`.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import astra
import h5py
import numpy as np
from measurement import Measurement
from numpy.typing import NDArray
from published_pipeline import PublishedObjective
from scanners import SCANNER
from scipy.optimize import nnls

from sawmill_calibration.known_geometry import GivenGeometry
from sawmill_calibration.reconstruction.reconstruct import run_reconstruction
from sawmill_calibration.scans.scan_rows import rows_of
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.reconstructions import ReconstructionOptions
from sawmill_formats.output.scan_reader import open_scan
from sawmill_formats.output.scan_writer import new_scan
from sawmill_formats.output.volume_writer import new_reconstruction
from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, FloatArray, Scanner, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction import cost
from sawmill_tomography.reconstruction._fbp_numba import back_project_16
from sawmill_tomography.reconstruction.fbp import Preparation, fbp
from sawmill_tomography.reconstruction.stack import most_concurrent, reconstruct_stack
from sawmill_vocabulary import FilterName, Progress, ReconstructionMethod

THETA = Theta(2.55023549, 714.683839, 319.943788, 43.6514375, 0.280799451)
VIEWS, CELLS, SIZE, SLICES = 360, 768, 256, 2500
# (views, cells, size, slices) that the cost model is fitted to.
GRID = ((90, 768, 256, 64), (360, 768, 128, 64), (360, 768, 256, 64), (360, 1536, 256, 32), (180, 384, 512, 32))
LAPS = 7
ODL = "ODL's `fbp_op` on ASTRA's CPU projector, one core"
UNTOLD: dict[str, Any] = {
    "pixel_mm": 1.0,
    "row_pitch_mm": None,
    "unit": "1/mm",
    "geometry": {},
    "parameters": {},
    "software_version": "",
    "input_sha256": "",
}
CORES = os.cpu_count() or 1


def projector(views: int, cells: int, size: int, *, irregular: bool = False) -> Projector:
    """Return a full turn of the published scanner with another detector; `irregular` shifts each view's angle."""
    angles = (np.arange(views) + 0.5) * TAU / views
    if irregular:
        angles += np.random.default_rng(1).uniform(-0.3, 0.3, views) * TAU / views
    scanner = Scanner(SCANNER.source_to_cor_mm, cells, SCANNER.detector_pitch_mm * CELLS / cells)
    return Projector(FanBeamGeometry(scanner, THETA, angles), ImageGrid(size, 400.0))


def layout(project: Projector, slices: int) -> tuple[int, int]:
    """Return slices a block and blocks at a time, as a job takes them."""
    views, cells = project.geometry.sinogram_shape
    return cost.blocks(views, cells, project.grid.size, slices, cost.MEMORY_BYTES, most_concurrent())


class Lap(NamedTuple):
    """Seconds by the clock, and of the processor: on a busy machine only the latter tell anything."""

    elapsed: float
    processor: float

    def __str__(self) -> str:
        return f"{1e3 * self.elapsed:8.2f} ms ({1e3 * self.processor:8.2f} ms of the processor)"


def in_turns(contestants: dict[str, Callable[[], object]], laps: int = LAPS) -> dict[str, Lap]:
    """Measure medians in turns, the first round left out; of two calls in succession the second is timed.

    The first call finds the caches and the other core as the previous work has left them.
    """
    taken: dict[str, list[Lap]] = {name: [] for name in contestants}
    for _ in range(laps + 1):
        for name, run in contestants.items():
            run()
            started, used = time.perf_counter(), time.process_time()
            run()
            taken[name].append(Lap(time.perf_counter() - started, time.process_time() - used))
    return {name: Lap(*np.median(of_one[1:], axis=0).tolist()) for name, of_one in taken.items()}


def astra_slice(geometry: FanBeamGeometry, sinogram: FloatArray) -> Callable[[], object]:
    """Return ASTRA's back-projection of a slice on the processor, without any filter: it has none for a fan."""
    grid = astra.create_vol_geom(SIZE, SIZE, -200.0, 200.0, -200.0, 200.0)
    rays = astra.create_projector(
        "line_fanflat", astra.create_proj_geom("fanflat_vec", CELLS, geometry.astra_vectors()), grid
    )

    def run() -> object:
        handle, image = astra.create_backprojection(sinogram, rays)
        astra.data2d.delete(handle)
        return image

    return run


def text_table(*rows: Sequence[object]) -> str:
    """Write rows as a table of a page, the first of them as its heading."""
    lines = ["| " + " | ".join(map(str, row)) + " |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])


def one_slice() -> str:
    """Print one slice compared with ODL and ASTRA; return a page's table."""
    regular, irregular = projector(VIEWS, CELLS, SIZE), projector(VIEWS, CELLS, SIZE, irregular=True)
    frame = regular.geometry.frame
    sinogram = analytic.project(L_SHAPE, DetectorCells.of(SCANNER), frame, regular.geometry.angles_rad)
    objective = PublishedObjective(SCANNER, L_SHAPE, sinogram)
    seconds = in_turns(
        {
            ODL: lambda: objective.image(THETA),
            "ASTRA's back-projection alone, one core": astra_slice(regular.geometry, sinogram),
            "any angles": lambda: fbp(irregular, sinogram),
            "a full turn of equal steps, a number of views divisible by four": lambda: fbp(regular, sinogram),
        }
    )
    print(f"one slice, {SIZE} x {SIZE} from {VIEWS} x {CELLS}, filter included")
    peer = seconds[ODL]
    for name, lap in seconds.items():
        print(f"  {name:64} {lap}, {peer.elapsed / lap.elapsed:6.1f} times ODL's speed", end="")
        print(f" ({CORES * peer.processor / lap.processor:.1f} by processor time over {CORES} cores)")
    rows = [(name, f"{1e3 * lap.elapsed:.1f}", f"{peer.elapsed / lap.elapsed:.1f}") for name, lap in seconds.items()]
    return text_table(("what", "ms", "times ODL's speed"), *rows)


def from_counts(project: Projector, slices: int) -> Callable[[], object]:
    """Return the reconstruction of images from the counts of some slices."""
    views, cells = project.geometry.sinogram_shape
    counts = np.random.default_rng(2).integers(5_000, 60_000, (views, slices, cells)).astype(np.float32)

    def run() -> object:
        return fbp(project, -np.log(counts / np.float32(60_000.0)).transpose(1, 0, 2)).image

    return run


def blocks() -> dict[str, Any]:
    """Print the speed of blocks, from counts to images; a page's table of it, and the rate of updates."""
    print(f"blocks, {SIZE} x {SIZE} from {VIEWS} x {CELLS}, counts to images")
    project = projector(VIEWS, CELLS, SIZE)
    contestants = {f"{slices} slices": from_counts(project, slices) for slices in (4, 16, 32, 64)}
    rows = []
    for (name, lap), slices in zip(in_turns(contestants, 5).items(), (4, 16, 32, 64), strict=True):
        each = Lap(lap.elapsed / slices, lap.processor / slices)
        print(
            f"  {name:24} {each} a slice; {VIEWS * SIZE**2 / each.elapsed / 1e9:5.1f} billion updates a second", end=""
        )
        print(f", {CORES * VIEWS * SIZE**2 / each.processor / 1e9:.1f} by processor time")
        rows.append((slices, f"{1e3 * each.elapsed:.1f}"))
    filtered = np.random.default_rng(5).standard_normal((VIEWS, CELLS + 2, 64), dtype=np.float32)
    volume = np.empty((64, SIZE, SIZE), np.float32)
    frame = Preparation.of(project, "exact", FilterName.HANN, 1.0).frame
    lap = in_turns({"alone": lambda: back_project_16(filtered, *frame, volume)}, 5)["alone"]
    updates = VIEWS * SIZE**2 * 64 / 1e9
    print(f"  back-projection alone: {updates / lap.elapsed:.1f} billion updates a second", end="")
    print(f", {CORES * updates / lap.processor:.1f} by processor time")
    heading = ("slices at a time", "ms a slice, counts to image")
    return {"blocks": text_table(heading, *rows), "billion_updates_per_s": updates / lap.elapsed}


def fit() -> str:
    """Fit the cost model's rates, rows in memory to a volume's file; return a page's table with the built-in rates."""
    rows, laps = [], []
    for views, cells, size, slices in GRID:
        project = projector(views, cells, size)
        stack = np.random.default_rng(3).standard_normal((views, slices, cells), dtype=np.float32)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "volume.h5"

            def run(project: Projector = project, stack: NDArray[np.float32] = stack, path: Path = path) -> None:
                shape = (stack.shape[1], project.grid.size, project.grid.size)
                step, concurrent = layout(project, shape[0])
                with new_reconstruction(path, shape, **UNTOLD) as volume:

                    def reconstruct(start: int, stop: int) -> Iterator[None]:
                        block = fbp(project, stack[:, start:stop].transpose(1, 0, 2)).image
                        yield
                        volume.write(start, block)

                    reconstruct_stack(shape[0], reconstruct, step=step, concurrent=concurrent)

            laps.append(in_turns({"stack": run}, 3)["stack"].processor / CORES / slices)
        rows.append((views * cells, views * size**2, size**2))
    system = np.array(rows) / np.array(laps)[:, None]
    scale = system.max(axis=0)
    rates = nnls(system / scale, np.ones(len(laps)))[0] / scale
    print(f"cost model, processor seconds over {CORES} cores a slice = a views cells + b views pixels + c pixels")
    print(f"  a = {rates[0]:.2e} s, b = {rates[1]:.2e} s, c = {rates[2]:.2e} s")
    lines = []
    for shape, measured, model in zip(GRID, laps, np.array(rows) @ rates, strict=True):
        built_in = (cost.seconds(*shape) - cost.SECONDS_A_STACK) / shape[3]
        print(
            f"  {shape!s:24} measured {1e3 * measured:6.2f} ms, fit {1e3 * model:6.2f}, built in {1e3 * built_in:6.2f}"
        )
        lines.append((*shape[:3], *(f"{1e3 * seconds:.2f}" for seconds in (measured, model, built_in))))
    return text_table(("views", "cells", "size", "measured, ms a slice", "fit", "model"), *lines)


def limits() -> float:
    """Print what the machine's memory allows: gigabytes that one core copies in a second."""
    values = np.ones(2**26, np.float32)
    copy = np.zeros_like(values)
    seconds = in_turns({"copy": lambda: np.copyto(copy, values)}, 5)["copy"].processor
    rate = 2 * values.nbytes / seconds / 1e9
    print(f"machine: {CORES} cores, one of them copies {rate:.1f} GB/s")
    return float(rate)


def make_log(path: Path) -> None:
    """Write a scan of SLICES rows of a turning L with noise, 2.8 GB."""
    project = projector(VIEWS, CELLS, SIZE)
    clean = analytic.project(L_SHAPE, DetectorCells.of(SCANNER), project.geometry.frame, project.geometry.angles_rad)
    rng = np.random.default_rng(4)
    stack = np.empty((VIEWS, SLICES, CELLS), np.float32)
    for view, row in enumerate(clean.astype(np.float32)):
        stack[view] = row + rng.standard_normal((SLICES, CELLS), dtype=np.float32)
    about = {"detector_pitch_mm": SCANNER.detector_pitch_mm, "row_pitch_mm": 2.0}
    with new_scan(path, stack.shape, angles_rad=project.geometry.angles_rad, **about) as written:
        written.data[...] = stack
        written.note(air_level=None, provenance={})


def reconstruct_log(scan: Path, volume: Path) -> None:
    """Reconstruct that scan as the job does; runs in a separate process."""
    used = time.process_time()
    with open_scan(scan) as stored:
        scanner = ScannerConstants(**vars(SCANNER), row_pitch_mm=stored.row_pitch_mm)
        given = rows_of(stored, scanner, rows=None, views=None, counts=True, sha256="0" * 64)
        reported: list[Progress] = []
        options = ReconstructionOptions(method=ReconstructionMethod.FBP, size=SIZE)
        result = run_reconstruction(given, GivenGeometry(scanner, THETA), options, volume, reported.append)
    predicted = [progress.seconds_left or 0.0 for progress in reported]
    each = Lap(result.time_s / SLICES, (time.process_time() - used) / CORES / SLICES)
    print(f"  {result.time_s:.1f} s, {each} a slice from file to file, shared by {CORES} cores; ", end="")
    print(f"{predicted[0]:.1f} s predicted at first, {predicted[len(predicted) // 2]:.1f} s half-way")
    volume.with_suffix(".json").write_text(json.dumps({"log_s": result.time_s, "predicted_s": predicted[0]}))


def whole_log() -> dict[str, float]:
    """Print the time and the largest memory of a log of SLICES slices, from file to file."""
    print(f"a log of {VIEWS} x {SLICES} x {CELLS}, {4 * VIEWS * SLICES * CELLS / 1e9:.2f} GB")
    step, concurrent = layout(projector(VIEWS, CELLS, SIZE), SLICES)
    bound = concurrent * cost.block_bytes(VIEWS, CELLS, SIZE, step)
    with tempfile.TemporaryDirectory() as folder:
        scan, volume = Path(folder) / "scan.h5", Path(folder) / "volume.h5"
        for task in ("--make", "--reconstruct"):
            child = subprocess.Popen([sys.executable, __file__, task, str(scan), str(volume)])  # noqa: S603 - ourselves
            largest = max(peaks(child), default=0)
        if child.returncode:
            raise SystemExit(child.returncode)
        seconds: dict[str, float] = json.loads(volume.with_suffix(".json").read_text())
        with h5py.File(volume) as file:
            packed = file["entry/reconstruction/data"].id.get_storage_size()
    print(f"  largest memory {largest / 1e9:.2f} GB, of which blocks at most {bound / 1e9:.2f} GB; ", end="")
    print(f"volume of {cost.volume_bytes(SIZE, SLICES) / 1e9:.2f} GB packed to {packed / 1e9:.2f} GB")
    each_ms = 1e3 * seconds["log_s"] / SLICES
    return {**seconds, "log_slice_ms": each_ms, "log_gb": largest / 1e9, "log_blocks_gb": bound / 1e9}


def peaks(child: subprocess.Popen[bytes]) -> Iterator[int]:
    """Yield the child's high-water mark in bytes, as the system reports it, until the child ends."""
    status = Path(f"/proc/{child.pid}/status")
    while child.poll() is None:
        lines = status.read_text(encoding="ascii").splitlines()
        yield from (int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM"))
        time.sleep(0.1)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--no-log", action="store_true", help="leave the whole log out (3 GB on the disk, a minute)")
    parser.add_argument("--make", nargs=2, type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--reconstruct", nargs=2, type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.make:
        make_log(options.make[0])
    elif options.reconstruct:
        reconstruct_log(*options.reconstruct)
    else:
        warnings.filterwarnings("ignore", message="The 'astra_cpu' backend may be too slow")
        measurement = Measurement.begin("worker/sawmill_tomography/reconstruction")
        values = {"one_slice": one_slice(), **blocks(), "model": fit(), "copied_gb_per_s": limits()}
        if not options.no_log:
            measurement.write({"fbp": values | whole_log()})


if __name__ == "__main__":
    main()
