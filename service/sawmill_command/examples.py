"""Simulated scans of the example scanner: the examples of a new data folder, and what the demo calibrates with."""

from pathlib import Path

import numpy as np

from sawmill_calibration.simulation import write_simulated_scan
from sawmill_command import seeding
from sawmill_command.seeding import LOG_ROWS, PHANTOM_ROWS, ROW_PITCH_MM, THETA
from sawmill_tomography.geometry.geometry import FanBeamGeometry, FloatArray, Scanner
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM, LogModel
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection.simulate import SimulatedStack, simulate_stack

SEED = 2206
SCANNER = Scanner(
    seeding.CONSTANTS.source_to_cor_mm, seeding.CONSTANTS.num_detector_pixels, seeding.CONSTANTS.detector_pitch_mm
)
LOG_START_MM = 192.0


def full_turn(views: int) -> FloatArray:
    """Return equidistant angles (views,) over a full turn, rad, starting at half a step."""
    return (np.arange(views) + 0.5) * 2.0 * np.pi / views


def mill_slices(*, log_rows: int = LOG_ROWS) -> list[Phantom]:
    """Return a log with the L-shaped phantom on its sawn end: phantom rows, then log rows."""
    wood = L_SHAPE.of_density(SAPWOOD_PER_MM).moved(3.0, -2.0)
    log = LogModel.random(SEED)
    return [wood] * PHANTOM_ROWS + [log.slice_at(LOG_START_MM + row * ROW_PITCH_MM) for row in range(log_rows)]


def mill_stack(views: int, slices: list[Phantom]) -> SimulatedStack:
    """Simulate raw counts of the example scanner."""
    return simulate_stack(slices, FanBeamGeometry(SCANNER, THETA, full_turn(views)), seed=SEED)


def write_mill_stack(path: Path, views: int, slices: list[Phantom]) -> None:
    """Write raw counts of the example scanner as an NXtomo file."""
    write_simulated_scan(path, mill_stack(views, slices), full_turn(views), SCANNER, ROW_PITCH_MM)
