"""Conjugate rays: over a full turn every ray is measured twice, once from either side.

With chi the direction of a ray in the plane, as a parallel beam's angle is counted,
P(chi + gamma, u(gamma)) = P(chi + pi - gamma, u(-gamma)) with u(gamma) = u_c + SDD sin gamma / cos(gamma + tau):
it contains no R, so u_c, tau and SDD can be fitted to any dense full-turn scan (docs/understand/drift.md#dense-scans;
the symmetry is in Kak and Slaney 1988, section 3.4.3). R and psi cannot be seen.

The fit to opposite rays from a calibrated geometry: the basin by a coarse blur, then as fine as the noise allows.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.drift.change import ConjugateFit, DriftError, LogMovement, better_sense, seen_vector
from sawmill_tomography.drift.levelled_rays import fitted_air
from sawmill_tomography.drift.log_screening import screen_log
from sawmill_tomography.drift.opposite_rays.disturbances import (
    ROUNDS,
    DisturbanceEstimate,
    Harmonics,
    estimates_of,
    log_movement,
    strongest,
    undetected_covariance,
    undisturbed,
    view_gain,
)
from sawmill_tomography.drift.opposite_rays.full_turn import FullTurn, check_full_turn, even_views, nearest_view
from sawmill_tomography.drift.opposite_rays.opposite_rays import ALL_THREE, WITHOUT_DISTANCE, Pairs, Solution
from sawmill_tomography.drift.opposite_rays.paired_rays import fan_angles
from sawmill_tomography.geometry.geometry import FloatArray, Scanner, SourceFrame
from sawmill_vocabulary import Rotation

# Lowest ratio of the residuals from which the other sense of rotation is ruled out.
DECISIVE_RATIO = 1.1
# A view whose rays differ from their opposites this many times more than the views' median does not belong to the turn;
# if this applies to more than this share of the views, the log moved. The opposites of such a view differ too: only
# views near the worst are left out at a time.
ODD_VIEW, MOST_ODD_VIEWS, NEAR_WORST = 3.0, 0.1, 0.7
# The residual of scatter and hardening in a measured scan changes slowly with the direction of a ray: over this share
# of the turn the differences count as correlated.
CORRELATED = 1 / 12
# A gain fitted with a wrong geometry hides part of the error: gain and geometry are fitted in turn this many times.
GAIN_ROUNDS = 3


def conjugate_fit(
    scanner: Scanner,
    sinogram: FloatArray,
    angles_rad: FloatArray,
    start: SourceFrame,
    rotation: Rotation = Rotation.AS_GIVEN,
) -> ConjugateFit:
    """Fit u_c, tau and SDD to the pairs of opposite rays of any object, in both senses of rotation.

    `sinogram` (views, detector) float: line integrals of any object that turned as one body, over a full turn.
    `angles_rad` (views,): view angles of the scan.
    """
    sinogram, angles_rad = np.asarray(sinogram, np.float64), np.asarray(angles_rad, np.float64)
    check_full_turn(sinogram, angles_rad)
    screening = screen_log(scanner, sinogram, rotation.apply(angles_rad), start)
    lines = screening.bridged(sinogram)
    # Opposite rays cancel a flat field that slopes, but the gains of the views would follow it.
    air = fitted_air(lines[screening.views])
    scan = _Scan(
        scanner,
        lines if air is None else lines - air.of_all_views,
        angles_rad,
        screening.views,
        ~screening.cells,
        np.zeros(sinogram.shape, bool) if screening.hidden is None else screening.hidden,
        screening.adjustments,
    )
    fit = steady = _fit_without_odd_views(scan, start, rotation)
    harmonics = Harmonics()
    for _ in range(ROUNDS):
        disturbance = strongest(fit.estimates, harmonics)
        if disturbance is None:
            break
        harmonics = harmonics.plus(disturbance)
        fit = _fit_without_odd_views(scan.undisturbed(harmonics, start, fit.rotation), start, fit.rotation)
    # A jump of the log contains every harmonic, and no harmonics explain it.
    movement = fit.movement(angles_rad, start)
    if harmonics.values.any() and movement.beyond_chance:
        fit, harmonics = steady, Harmonics()
        movement = fit.movement(angles_rad, start)
    best, used = fit.best, fit.scan
    disagreeing = int(np.sum(screening.views & ~used.usable))
    remark = f"{disagreeing} views whose rays do not agree with their opposites were left out"
    refuse_unseen(scanner, best, start)
    u_c, tau, sdd = (float(value) for value in best.vector)
    return ConjugateFit(
        u_c,
        tau,
        sdd,
        best.with_correlated(CORRELATED).covariance + undetected_covariance(best, fit.estimates),
        distance_held=best.free == WITHOUT_DISTANCE,
        rotation=fit.rotation,
        rotation_ratio=fit.ratio,
        rotation_decided=fit.ratio > DECISIVE_RATIO,
        relative_residual=best.relative_residual,
        distance_sensitivity=best.distance_sensitivity,
        movement=movement,
        adjustments=(*used.done, remark) if disagreeing else used.done,
        disturbances=harmonics.amplitudes(start.source_distance_mm),
    )


@dataclass(frozen=True, eq=False)
class _Scan:
    """The sinogram to fit, its usable views, the cells and samples left out, and the corrections made."""

    scanner: Scanner
    sinogram: FloatArray
    angles_rad: FloatArray
    usable: NDArray[np.bool_]
    bridged: NDArray[np.bool_]
    left_out: NDArray[np.bool_]
    done: tuple[str, ...]

    def turn(self, even: FloatArray, first_rad: float) -> FullTurn:
        """Return the full turn of the scan's views at equidistant angles, with the first view's angle."""
        return FullTurn.of(
            even, first_rad, self.angles_rad, usable=self.usable, bridged=self.bridged, left_out=self.left_out
        )

    def undisturbed(self, harmonics: Harmonics, start: SourceFrame, rotation: Rotation) -> "_Scan":
        """Return the scan without these disturbances of the turn, which are in this sense of rotation."""
        sinogram, angles = undisturbed(
            self.scanner, seen_vector(start), self.sinogram, rotation.apply(self.angles_rad), harmonics
        )
        return replace(self, sinogram=sinogram, angles_rad=rotation.apply(angles))


@dataclass(frozen=True, eq=False)
class _OppositeRaysFit:
    """The fit in the better sense of rotation, the ratio of the two residuals, and the corrected scan."""

    best: Solution
    rotation: Rotation
    ratio: float
    scan: _Scan

    @cached_property
    def estimates(self) -> list[DisturbanceEstimate]:
        """Disturbances of the turn, estimated from the differences of opposite rays."""
        return estimates_of(self.best)

    def movement(self, angles_rad: FloatArray, start: SourceFrame) -> LogMovement:
        """Estimate the log's jump; `angles_rad` are the scan's angles."""
        return log_movement(self.best, self.rotation.apply(angles_rad), start.source_distance_mm)


def _fit_without_odd_views(scan: _Scan, start: SourceFrame, rotation: Rotation) -> _OppositeRaysFit:
    """Fit as `_fit`, using only the views that agree with the rest of the scan."""
    fit = _fit(scan, start, rotation)
    while (odd := _odd_views(scan, fit.best, fit.rotation)).any():
        scan = replace(scan, usable=scan.usable & ~odd)
        fit = _fit(scan, start, fit.rotation)
    return fit


def _fit(scan: _Scan, start: SourceFrame, rotation: Rotation) -> _OppositeRaysFit:
    """Fit the geometry to the usable views."""
    even, first = even_views(scan.sinogram, scan.angles_rad, scan.usable)
    turn = scan.turn(even, first)
    basins = {sense: coarse_minimum(scan.scanner, turn.read(sense), start) for sense in Rotation}
    residuals = {sense: basin.relative_residual for sense, basin in basins.items()}
    rotation, ratio = better_sense(residuals, rotation, DECISIVE_RATIO)
    vector, done = basins[rotation].vector, scan.done
    for _ in range(GAIN_ROUNDS):
        fan, _ = fan_angles(scan.scanner, vector)
        gain = view_gain(even, fan, reversed_turn=rotation is Rotation.REVERSED)
        if gain is not None:
            turn = scan.turn(gain.removed(even), first)
            done = (*scan.done, gain.done)
        best = fine_minimum(scan.scanner, turn.read(rotation), start, vector)
        if gain is None or not best.settled or best.is_near(vector):
            break
        vector = best.vector
    return _OppositeRaysFit(best, rotation, ratio, replace(scan, done=done))


def _odd_views(scan: _Scan, best: Solution, rotation: Rotation) -> NDArray[np.bool_]:
    """Select the views (views,) whose rays differ from their opposites far more than is usual in the scan."""
    views, first_rad = scan.angles_rad.size, float(scan.angles_rad.min())
    squares = np.where(best.rays.used, best.rays.difference**2, 0.0).ravel()
    sums, counts = np.zeros(views), np.zeros(views)
    for angles in best.pairs.views_of():
        nearest = nearest_view(angles, first_rad, views).ravel()
        sums += np.bincount(nearest, squares, views)
        counts += np.bincount(nearest, best.rays.used.ravel(), views)
    rms = np.sqrt(sums / np.maximum(counts, 1.0))
    at = nearest_view(rotation.apply(scan.angles_rad), first_rad, views)
    odd: NDArray[np.bool_] = (
        scan.usable & (rms > max(ODD_VIEW * float(np.median(rms)), NEAR_WORST * float(rms.max())))[at]
    )
    return odd if np.sum(odd | ~scan.usable) <= MOST_ODD_VIEWS * views else np.zeros(views, bool)


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
        solution = Pairs(scanner, turn, basin, blur).solve(basin, *reach(scanner, start), free=free, corrected=True)
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
