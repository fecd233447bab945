"""A phantom before a log, counts, views that lost rows: how well shifts are found, and what a row loses with its views.

    python benchmarks/lost_rows.py

Counts of 20 000 photons with ten flats; the gain of the detector's rows differs by 5 %. Errors are in rows. Next to the
errors of shifts is their root mean square in standard deviations, before they were taken as whole. Of slices the
relative error by filtered back-projection is given: complete, with a share of the views less at random whose neighbours
are weighed by the gaps, and with those views interpolated. Takes two minutes.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sawmill_calibration.conversion import to_phantom
from sawmill_calibration.phantom_drawings import drawing_of
from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, FloatArray, GeometryError, Scanner, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM, LogModel
from sawmill_tomography.preparing.line_integrals import Exposure
from sawmill_tomography.preparing.row_shifts import RowsError, RowShifts, jumps_between
from sawmill_tomography.preparing.shifts_by_features import shifts_by_features
from sawmill_tomography.preparing.shifts_by_mass import RowMoments, shifts_by_mass
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.fbp import fbp
from sawmill_tomography.reconstruction.quality import relative_error
from sawmill_tomography.sinograms.present_rows import filled

Stack = NDArray[np.float32]
SCANNER = Scanner(source_to_cor_mm=859.46, num_detector_pixels=256, detector_pitch_mm=4.5)
THETA = Theta(0.9, 710.0, 240.0, 35.0, 0.2)
BOARD, ROWS, MOST_LOST, PHOTONS = 12, 60, 6, 20_000.0
WAYS: dict[str, Callable[[Stack, FloatArray], RowShifts]] = {
    "profile": lambda stack, angles: shifts_by_mass(RowMoments.of(stack, np.ones(stack.shape[2], bool)), angles),
    "features": shifts_by_features,
}


def full_turn(views: int) -> FloatArray:
    """Return equal steps from half a step on."""
    return (np.arange(views) + 0.5) * TAU / views


def stack_of(seed: int, angles: FloatArray, board: int, row_pitch_mm: float) -> Stack:
    """Simulate line integrals (views, rows, cells)."""
    frame, cells = THETA.source_frame(SCANNER.source_to_cor_mm), DetectorCells.of(SCANNER)
    phantom = to_phantom(drawing_of("l-shape")).moved(12.0, -8.0).of_density(SAPWOOD_PER_MM)
    log = LogModel.random(seed)
    bodies = [log.slice_at(20.0 + row_pitch_mm * row) for row in range(ROWS - board)]
    bodies = [phantom] * min(board, 1) + bodies
    rows = [analytic.project(body, cells, frame, angles, rays_per_cell=1) for body in bodies]
    return np.stack(rows[:1] * max(board - 1, 0) + rows, axis=1).astype(np.float32)


def exposed(lines: Stack, rng: np.random.Generator) -> Stack:
    """Simulate line integrals of counts, with flats averaged over all rows: the views' rows are not yet identified."""
    rows, cells = lines.shape[1:]
    gain = PHOTONS * (1.0 + 0.05 * rng.standard_normal((rows, 1)) + 0.03 * rng.standard_normal((rows, cells)))
    counts = rng.poisson(0.98 * gain * np.exp(-lines)).astype(np.float32)
    Exposure.of(rng.poisson(gain, (10, rows, cells)).astype(np.float32), None).same_in_all_rows().to_line_integrals(
        counts
    )
    return counts


def lose_rows(stack: Stack, rng: np.random.Generator) -> tuple[Stack, FloatArray]:
    """Remove 1 to 6 rows from a third of the views and move these views up; return the stack and the shifts."""
    lost, shift = stack.copy(), np.zeros(len(stack))
    for view in rng.permutation(len(stack))[: len(stack) // 3]:
        gone = int(rng.integers(1, MOST_LOST + 1))
        top = int(rng.integers(0, gone + 1))
        lost[view], shift[view] = np.nan, top
        lost[view, : ROWS - gone] = stack[view, top : ROWS - gone + top]
    return lost, shift


def move_by_parts(lines: Stack, rng: np.random.Generator) -> tuple[Stack, FloatArray]:
    """Move a third of the views along the log by parts of a row, which mix two rows; return stack and shifts."""
    moved, shift = lines.copy(), np.zeros(len(lines))
    for view in rng.permutation(len(lines))[: len(lines) // 3]:
        shift[view] = rng.uniform(0.0, 1.0)
        moved[view, :-1] += np.float32(shift[view]) * (lines[view, 1:] - lines[view, :-1])
        moved[view, -1] = np.nan
    return moved, shift


def reported(name: str, way: str, stack: Stack, angles: FloatArray, truth: FloatArray) -> str:
    """Report the error of a way."""
    try:
        found = WAYS[way](stack, angles)
    except RowsError as error:
        return f"{name}, {way}: refused, {error}"
    error = found.rows - truth
    ratio = float(np.sqrt(np.mean((error / found.standard_deviation) ** 2)))
    resampled = int((found.rows != np.rint(found.rows)).sum())
    return (
        f"{name}, {way}: error {error.std():.3f} RMS, {np.abs(error).max():.3f} most, {ratio:.2f} standard deviations; "
        f"{resampled} of {truth.size} views resampled"
    )


def shifts() -> None:
    """Print both ways' errors, on stacks that lost whole rows and on stacks whose views moved by parts of a row."""
    for views in (60, 180):
        angles = full_turn(views)
        for seed in (1, 2):
            for board in (0, BOARD):
                lines, rng = stack_of(seed, angles, board, 2.0), np.random.default_rng(seed)
                name = f"{views} views, log {seed}, board of {board} rows"
                print(f"{name}: bodies end at {np.flatnonzero(jumps_between(lines.sum(axis=2).mean(axis=0)))}")
                lost, truth = lose_rows(exposed(lines, rng), rng)
                for way in WAYS:
                    print(reported(f"{name}, rows lost", way, lost, angles, truth), flush=True)
                moved, truth = move_by_parts(lines, rng)
                noisy = moved + 0.025 * rng.standard_normal(moved.shape).astype(np.float32)
                print(reported(f"{name}, moved by parts", "profile", noisy, angles, truth), flush=True)


def slices() -> None:
    """Print the errors of a row of the board and one of the log, with fewer views."""
    for views in (60, 180, 360):
        angles = full_turn(views)
        lines = stack_of(1, angles, BOARD, 2.0)
        projector = Projector(FanBeamGeometry(SCANNER, THETA, angles), ImageGrid(128, 400.0))
        for name, row in (("board", 3), ("log", 30)):
            truth = fbp(projector, lines[:, row]).image
            noise = (
                0.01 * np.random.default_rng(1).standard_normal((views, 1, 256)) * np.exp(lines[:, row : row + 1] / 2)
            )
            stack = (lines[:, row : row + 1] + noise).astype(np.float32)

            complete = relative_error(fbp(projector, stack[:, 0]).image, truth)
            for share in (0.05, 0.2, 1.0 / 3.0, 0.5):
                there = np.random.default_rng(2).random(views) >= share
                some = Projector(projector.geometry.with_angles(angles[there]), projector.grid)
                try:
                    weighed = f"{relative_error(fbp(some, stack[there, 0]).image, truth):.3f}"
                except GeometryError:
                    weighed = "refused"
                lacking = stack.copy()
                lacking[~there] = np.nan
                interpolated = relative_error(fbp(projector, filled(lacking, angles)[:, 0]).image, truth)
                print(
                    f"{views} views, {name}, {share:.0%} less: complete {complete:.3f}, gaps weighed {weighed}, "
                    f"interpolated {interpolated:.3f}",
                    flush=True,
                )


if __name__ == "__main__":
    slices()
    shifts()
