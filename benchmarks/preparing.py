"""Results of preparing a stack: shifts of views that lost rows, both ways, and cost and gain of ring removal.

    python benchmarks/preparing.py

Three simulated logs, lost rows 0 to 10 at each end, noise of a line integral as given. `off` is the RMS of the shifts'
errors less their mean, `refused` that the way given it cannot. Takes a few minutes.
"""

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, FloatArray, Scanner, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.preparing.ring_removal import remove_rings
from sawmill_tomography.preparing.row_shifts import RowsError, RowShifts
from sawmill_tomography.preparing.shifts_by_features import shifts_by_features
from sawmill_tomography.preparing.shifts_by_mass import RowMoments, shifts_by_mass
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.fbp import fbp
from sawmill_tomography.reconstruction.quality import relative_error

Stack = NDArray[np.float32]
THETA = Theta(0.9, 710.0, 240.0, 35.0, 0.2)
ROWS, ROW_PITCH_MM, MOST_LOST = 120, 2.0, 10
WAYS: dict[str, Callable[[Stack, FloatArray], RowShifts]] = {
    "profile": lambda stack, angles: shifts_by_mass(RowMoments.of(stack, np.ones(stack.shape[2], bool)), angles),
    "features": shifts_by_features,
}


def log_stack(seed: int, angles: FloatArray, cells: int) -> Stack:
    """Simulate line integrals (views, rows, cells)."""
    scanner = Scanner(source_to_cor_mm=859.46, num_detector_pixels=cells, detector_pitch_mm=1152.0 / cells)
    log, frame, detector = LogModel.random(seed), THETA.source_frame(859.46), DetectorCells.of(scanner)
    heights = 20.0 + ROW_PITCH_MM * np.arange(ROWS)
    rows = [analytic.project(log.slice_at(z), detector, frame, angles, rays_per_cell=1) for z in heights]
    return np.stack(rows, axis=1).astype(np.float32)


def lose_rows(stack: Stack, rng: np.random.Generator) -> tuple[Stack, FloatArray]:
    """Remove some rows of each view and move the view up; return the stack and the number of rows lost at the top."""
    top, bottom = rng.integers(0, MOST_LOST + 1, (2, len(stack)))
    lost = np.full_like(stack, np.nan)
    for view, image in enumerate(stack):
        kept = ROWS - top[view] - bottom[view]
        lost[view, :kept] = image[top[view] : top[view] + kept]
    return lost, top.astype(np.float64)


def reported(way: str, lost: Stack, angles: FloatArray, truth: FloatArray) -> str:
    """Report how far off a way is, and its processor seconds."""
    started = time.process_time()
    try:
        shifts = WAYS[way](lost, angles)
    except RowsError:
        return f"{way}: refused"
    seconds = time.process_time() - started
    off = (shifts.rows - truth).std()
    return f"{way}: off {off:.3f}{' (whole)' if shifts.whole else ''}, {seconds:.1f} processor seconds"


def missing_rows() -> None:
    """Print the errors for views over a full turn."""
    for views, cells in ((60, 256), (180, 384)):
        angles = (np.arange(views) + 0.5) * TAU / views
        for seed in (1, 2, 3):
            clean = log_stack(seed, angles, cells)
            for noise in (0.01, 0.03, 0.1):
                rng = np.random.default_rng(seed)
                noisy = clean + noise * rng.standard_normal(clean.shape).astype(np.float32)
                lost, truth = lose_rows(noisy, rng)
                answers = "; ".join(reported(way, lost, angles, truth) for way in WAYS)
                print(f"{views} views, log {seed}, noise {noise}: {answers}", flush=True)


def rings() -> None:
    """Print one slice from 360 views, stripes of unequal cells as a share of the deepest shadow."""
    scanner = Scanner(source_to_cor_mm=859.46, num_detector_pixels=768, detector_pitch_mm=1.5)
    geometry = FanBeamGeometry(scanner, THETA, (np.arange(360) + 0.5) * TAU / 360)
    projector, cells = Projector(geometry, ImageGrid(256, 400.0)), DetectorCells.of(scanner)
    for seed in (1, 2, 3):
        body = LogModel.random(seed).slice_at(60.0)
        clean = analytic.project(body, cells, geometry.frame, geometry.angles_rad, rays_per_cell=4).astype(np.float32)
        truth = fbp(projector, clean).image
        for share in (0.0, 0.002, 0.005, 0.01):
            stripes = np.random.default_rng(seed).standard_normal(768) * share * clean.max()
            striped = clean + stripes.astype(np.float32)
            errors = [
                relative_error(fbp(projector, sinogram).image, truth) for sinogram in (striped, remove_rings(striped))
            ]
            print(
                f"log {seed}, stripes {share:.1%}: relative error {errors[0]:.4f}, sorted {errors[1]:.4f}", flush=True
            )


if __name__ == "__main__":
    rings()
    missing_rows()
