"""The fit to opposite rays from a calibrated geometry: the basin by a coarse blur, then as fine as the noise allows."""

import math
from itertools import product

import numpy as np

from sawmill_tomography.drift.change import DriftError, seen_vector
from sawmill_tomography.drift.opposite_rays.full_turn import FullTurn
from sawmill_tomography.drift.opposite_rays.opposite_rays import ALL_THREE, WITHOUT_DISTANCE, Pairs, Solution
from sawmill_tomography.geometry.geometry import FloatArray, Scanner, SourceFrame

# Blur in views and in cells: the coarse one finds the basin and the sense of rotation, the finest one that the noise
# allows finds the minimum.
COARSE = (4.0, 8.0)
# The coarse blur leaves nothing of more than this share of the views' harmonics.
COARSE_SHARE = 1 / 3
FINE = ((1.0, 1.5), (1.5, 2.5), (2.0, 4.0), (3.0, 6.0))
# How far u_c (share of the detector), tau (rad) and SDD (share) may have moved and are still followed.
REACH = (0.05, 0.2, 0.2)
# An SDD less certain than this share of itself is not seen: it is held at the calibrated one.
WORST_DISTANCE = 0.02
# A u_c less certain than this share of a cell says nothing about drift.
WORST_CELLS = 0.5
# A tau less certain than this (rad) says nothing either: in so flat a basin the fit is not linear.
WORST_TILT = 0.03


def coarse_minimum(scanner: Scanner, turn: FullTurn, start: SourceFrame) -> Solution:
    """Find the coarse fit, with SDD held: SDD needs the fine structure of the log."""
    few = turn.of_fewer_views(math.ceil(COARSE_SHARE * turn.views))
    pairs = Pairs(scanner, few, seen_vector(start), (COARSE[0] * few.views / turn.views, COARSE[1]))
    return pairs.solve(seen_vector(start), *reach(scanner, start), free=WITHOUT_DISTANCE, corrected=False)


def fine_minimum(scanner: Scanner, turn: FullTurn, start: SourceFrame, basin: FloatArray) -> Solution:
    """Refine the coarse fit: as fine, and with as many unknowns, as the scan allows."""
    worst = (WORST_CELLS * scanner.detector_pitch_mm, WORST_TILT, WORST_DISTANCE * start.source_to_detector_mm)
    for free, blur in product((ALL_THREE, WITHOUT_DISTANCE), FINE):
        pairs = Pairs(scanner, turn, basin, blur)
        solution = pairs.solve(basin, *reach(scanner, start), free=free, corrected=True)
        if solution.settled and np.all(np.sqrt(np.diag(solution.covariance)) < worst):
            break
    return solution


def refuse_unseen(scanner: Scanner, solution: Solution, start: SourceFrame) -> None:
    """Refuse, as a `DriftError`, a fit that did not come to rest or leaves u_c or tau too uncertain."""
    certain = WORST_CELLS * scanner.detector_pitch_mm
    if not (solution.covariance[0, 0] < certain**2 and solution.covariance[1, 1] < WORST_TILT**2):
        raise DriftError(
            "nothing-seen",
            f"opposite rays do not place the centre of rotation on the detector to {certain:.3g} mm and the tilt to "
            f"{math.degrees(WORST_TILT):.2g} degrees: average more rows, scan a log that is less round or less "
            "centred, or calibrate with the phantom",
        )
    if not solution.settled:
        raise DriftError(
            "moved-too-far",
            f"no geometry near the known one (u_c {start.cor_column_mm:.4g} mm) makes opposite rays agree: the "
            "log moved while it was scanned, the calibration is another scanner's, or the geometry moved by more than "
            f"{REACH[0]:.0%} of the detector; calibrate with the phantom",
        )


def reach(scanner: Scanner, start: SourceFrame) -> tuple[FloatArray, FloatArray]:
    """Return the least and the largest (u_c, tau, SDD) that are still followed, (3,) each."""
    centre = seen_vector(start)
    width = scanner.num_detector_pixels * scanner.detector_pitch_mm
    away = np.array(REACH) * [width, 1.0, start.source_to_detector_mm]
    return centre - away, centre + away
