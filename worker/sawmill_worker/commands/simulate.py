"""`sawmill simulate`: analytic, seeded scan of a phantom or a synthetic log."""

import json
from pathlib import Path

import numpy as np

from sawmill_calibration.conversion import to_phantom
from sawmill_calibration.scans.simulation import read_physics, write_simulated_scan
from sawmill_contracts.geometry import ScannerConstants
from sawmill_formats.input.angles import AnglesGiven
from sawmill_formats.output.scan_writer import write_scan
from sawmill_tomography.geometry.geometry import FanBeamGeometry
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection.simulate import UNEQUAL_CELLS, simulate_rows, simulate_stack
from sawmill_vocabulary import DataKind, Handedness, Rotation, Theta
from sawmill_worker.commands.geometry_options import Position
from sawmill_worker.commands.phantom_options import PhantomSource
from sawmill_worker.commands.phantoms import drawing_of


def simulate_scan(
    output: Path,
    slices: list[Phantom],
    *,
    data: DataKind,
    scanner: ScannerConstants,
    theta: Theta,
    rotation: Rotation,
    angles: AnglesGiven,
    views: int,
    noise: float,
    background: float,
    photons: float,
    seed: int,
    physics: Path | None,
) -> None:
    """Write one cross-section per row, in NXtomo layout: raw counts with flats and darks, or line integrals."""
    angles_rad = np.deg2rad(angles.expand(views))
    turned = rotation.apply(angles_rad)
    fan = FanBeamGeometry(scanner, theta, turned)
    if data is DataKind.COUNTS:
        effects = UNEQUAL_CELLS if physics is None else read_physics(physics)
        stack = simulate_stack(slices, fan, effects, photons=photons, seed=seed)
        write_simulated_scan(
            output, stack, angles_rad, detector_pitch_mm=scanner.detector_pitch_mm, row_pitch_mm=scanner.row_pitch_mm
        )
    else:
        write_scan(
            output,
            line_integrals=simulate_rows(slices, fan, noise=noise, background=background, seed=seed),
            angles_rad=angles_rad,
            detector_pitch_mm=scanner.detector_pitch_mm,
            row_pitch_mm=scanner.row_pitch_mm,
            air_level=None,
            provenance={
                "simulated": slices[-1].name,
                "seed": str(seed),
                "theta": json.dumps(vars(theta), separators=(",", ":")),
            },
        )


def phantom_slices(
    phantom: PhantomSource, rows: int, *, handedness: Handedness, position: Position, as_wood: bool
) -> list[Phantom]:
    """Return the same phantom for each row; with `as_wood` it attenuates like sapwood, else by its drawn densities."""
    drawn = to_phantom(drawing_of(phantom))
    seen = drawn if handedness is Handedness.AS_DRAWN else drawn.mirrored()
    moved = seen.moved(position.x, position.y)
    return [moved.of_density(SAPWOOD_PER_MM) if as_wood else moved] * rows
