"""Simulated scans of the example scanner: the examples of a new data folder, and what the demo calibrates with.

`python -m sawmill_command.examples` writes the files of the examples again, which a nightly test compares.
"""

import io
from functools import partial
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter

from sawmill_calibration.calibration.fixed_pairs import read_paired_scanner
from sawmill_calibration.simulation import write_passages, write_simulated_scan
from sawmill_command import seeding
from sawmill_command.seeding import LOG_ROWS, PHANTOM_ROWS, ROW_PITCH_MM, THETA
from sawmill_contracts.fixed_pairs import DECLARATION
from sawmill_tomography.geometry.geometry import FanBeamGeometry, FloatArray, Scanner
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM, LogModel
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection.simulate import SimulatedStack, simulate_stack
from sawmill_vocabulary import PairedScanner

SEED = 2206
# Two passages of a board that lies well apart in them, and one of a log whose nails two pairs place.
PAIR_ROWS, PAIR_LOG_ROWS, PHOTONS, PAIR_SEED = 16, 32, 30_000.0, 5
SCANNER = Scanner(
    seeding.CONSTANTS.source_to_cor_mm, seeding.CONSTANTS.num_detector_pixels, seeding.CONSTANTS.detector_pitch_mm
)
LOG_START_MM = 192.0


def full_turn(views: int) -> FloatArray:
    """Return equidistant angles (views,) over a full turn, rad, starting at half a step."""
    return (np.arange(views) + 0.5) * 2.0 * np.pi / views


def mill_slices(*, log_rows: int = LOG_ROWS, row_pitch_mm: float = ROW_PITCH_MM) -> list[Phantom]:
    """Return a log with the L-shaped phantom on its sawn end: phantom rows, then log rows."""
    wood = L_SHAPE.of_density(SAPWOOD_PER_MM).moved(3.0, -2.0)
    log = LogModel.random(SEED)
    return [wood] * PHANTOM_ROWS + [log.slice_at(LOG_START_MM + row * row_pitch_mm) for row in range(log_rows)]


def mill_stack(views: int, slices: list[Phantom]) -> SimulatedStack:
    """Simulate raw counts of the example scanner."""
    return simulate_stack(slices, FanBeamGeometry(SCANNER, THETA, full_turn(views)), seed=SEED)


def write_mill_stack(path: Path, views: int, slices: list[Phantom]) -> None:
    """Write raw counts of the example scanner as an NXtomo file."""
    write_simulated_scan(path, mill_stack(views, slices), full_turn(views), SCANNER, ROW_PITCH_MM)


def record(folder: Path) -> None:
    """Write the files of the examples of a new data folder."""
    write_mill_stack(folder / seeding.STACK_FILE, 120, mill_slices())
    # A scan of the phantom alone, small enough to be tried from a browser.
    views = 60
    stack = mill_stack(views, mill_slices()[:1])
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer, projections=stack.counts, flats=stack.flats, darks=stack.darks, angles_deg=np.rad2deg(full_turn(views))
    )
    (folder / seeding.PHANTOM_FILE).write_bytes(buffer.getvalue())
    pairs = TypeAdapter(PairedScanner).validate_python({"pairs": DECLARATION.to_ask.example["body"]["pairs"]})
    passed = partial(write_passages, row_pitch_mm=ROW_PITCH_MM, photons=PHOTONS, seed=PAIR_SEED)
    board, true = L_SHAPE.of_density(SAPWOOD_PER_MM), folder / "pairs-true.json"
    passed(folder / "pairs.h5", board, pairs, passages=2, rows=PAIR_ROWS, off_mm=10.0)
    passed(folder / "log.h5", None, read_paired_scanner(true), passages=1, rows=PAIR_LOG_ROWS, off_mm=0.0)
    for written in (true, folder / "log-true.json", folder / "log-marks.json"):
        written.unlink()


if __name__ == "__main__":
    record(seeding.RECORDED)
