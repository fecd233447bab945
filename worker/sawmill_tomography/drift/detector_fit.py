"""The detector's geometry from a scan of a log: by opposite rays where the scan has them, else by pairs of views.

The detector's geometry from few views: by pairs of views, and by opposite rays where the views cover a full turn.
Pairs of views compare sums over different paths, on which hardening and scatter differ; opposite rays run along the
same path, but few views hardly show the differences of a round log. Each estimate counts by its covariance.
"""

import math
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.drift.change import (
    CHANCE_OF_A_JUMP,
    DetectorFit,
    Disturbance,
    DriftError,
    LogMovement,
    seen_vector,
)
from sawmill_tomography.drift.levelled_rays import levelled_rays
from sawmill_tomography.drift.opposite_rays.conjugate_rays import conjugate_fit, reach
from sawmill_tomography.drift.opposite_rays.disturbances import (
    DisturbanceEstimate,
    estimates_of,
    log_movement,
    shifted,
    undetected_covariance,
    view_gain,
)
from sawmill_tomography.drift.opposite_rays.full_turn import FullTurn, even_views, opposite_rays_pair, widest_gap_rad
from sawmill_tomography.drift.opposite_rays.opposite_rays import CUT_OFF, WITHOUT_DISTANCE, Pairs, Solution
from sawmill_tomography.drift.opposite_rays.paired_rays import fan_angles
from sawmill_tomography.drift.view_pairs.pair_sums import ENCODER_DEG, ScanMotions
from sawmill_tomography.drift.view_pairs.view_pairs import MOST_VIEWS, REACH, UNREST, PairFit, scan_times, view_pair_fit
from sawmill_tomography.geometry.detector_shape import FlatDetector, flat_borders_mm
from sawmill_tomography.geometry.geometry import TAU, FloatArray, Scanner, SourceFrame
from sawmill_vocabulary import ObjectTurns, Rotation

# Where opposite rays leave u_c uncertain by more than this share of a cell, motions during the scan disturb them: pairs
# of views fit those (benchmarks/production_logs.py: 360 views with slides or wrong turns).
UNCERTAIN_CELLS = 0.01


def detector_fit(
    scanner: Scanner,
    sinogram: FloatArray,
    angles_rad: FloatArray,
    start: SourceFrame,
    rotation: Rotation,
    *,
    deviations: FloatArray | None = None,
) -> DetectorFit:
    """Fit the detector's geometry by `conjugate_fit`, which is finer and sees SDD, or else by `few_view_fit`.

    Where both answer, and the first is uncertain, the more certain u_c counts.

    Parameters
    ----------
    deviations : (views, detector) float64, optional
        Parameter of `few_view_fit`. Opposite rays need none: their errors follow from the rays' differences.

    Raises
    ------
    DriftError
        Error of `conjugate_fit` or `few_view_fit`; or the scanner turns the log between passages.
    GeometryError
        Error of `few_view_fit`.
    """
    if scanner.object_turns is ObjectTurns.BETWEEN_PASSAGES:
        raise DriftError(
            "turned-between-passages",
            "this log does not tell whether the scanner has moved, because it is turned between passages and stands "
            "elsewhere in each view: reconstruct it with view_poses, and scan the phantom to check the scanner",
        )
    across_gaps = None
    if scanner != scanner.with_equal_cells:
        # Opposite rays are interpolated between cells at equal distances.
        flat = FlatDetector.of(flat_borders_mm(scanner, start), scanner)
        sinogram, scanner = flat.resampled(sinogram), scanner.with_equal_cells
        across_gaps = flat.across_gaps
        if deviations is not None:
            # Where they jump, a cubic overshoots: below 0 they would be no deviations.
            nearest = np.minimum(*(deviations[..., cells] for cells in flat.cells[1:3]))
            deviations = np.maximum(flat.resampled(deviations), nearest)
    of_pairs = partial(
        few_view_fit, scanner, sinogram, angles_rad, start, rotation, deviations=deviations, interpolated=across_gaps
    )
    if not opposite_rays_pair(angles_rad):
        return of_pairs()
    by_opposite = conjugate_fit(scanner, sinogram, angles_rad, start, rotation)
    if by_opposite.deviation[0] <= UNCERTAIN_CELLS * scanner.detector_pitch_mm:
        return by_opposite
    try:
        by_pairs = of_pairs()
    except DriftError:
        # What pairs of views cannot answer, opposite rays have answered with their larger uncertainty.
        return by_opposite
    more_certain = by_pairs.deviation[0] < by_opposite.deviation[0]
    return replace(by_pairs, movement=by_opposite.movement) if more_certain else by_opposite


# Blur of opposite rays in views, and at least in cells: more removes signal, and less leaves more aliasing.
BLUR_VIEWS, BLUR_CELLS = 0.6, 3.0
# What is finer than this share of the way that the log's rim moves from view to view is aliased. A blur by more than
# this share of the log would leave little to compare (benchmarks/measured.py, benchmarks/production_logs.py).
RIM_SHARE, COARSEST = 0.2, 0.08
# Views with a gap of more than this number of even steps are not interpolated.
WIDEST_GAP = 1.5
# Views whose angles are wrong by more than this share of a step are not interpolated either: 20 such views looked like
# those of a log that jumped by 0.5 mm.
MOST_TURNED = 0.05
# Unrest matters where it makes u_c less certain than this share of a cell.
UNREST_CELLS = 0.03
# Where the fit to pairs does not settle, opposite rays are used alone if u_c is known to this share of a cell.
CERTAIN_CELLS = 0.3
# Chi-squared, 2 degrees of freedom, by which pairs and opposite rays differ in one of twenty scans.
BY_CHANCE = 5.99
# A shorter jump, in cells at the COR, is ignored: bearings and scatter look like it.
SHORTEST_JUMP_CELLS = 0.5
# Fewer views have too few opposite rays to show a jump.
FEWEST_JUMPED = 12


def few_view_fit(
    scanner: Scanner,
    sinogram: FloatArray,
    angles_rad: FloatArray,
    start: SourceFrame,
    rotation: Rotation,
    *,
    deviations: FloatArray | None = None,
    interpolated: NDArray[np.bool_] | None = None,
) -> DetectorFit:
    """Fit u_c and tau to pairs of views and, for views over a full turn, to opposite rays; SDD is held.

    Parameters and errors are documented in `view_pair_fit`. Where the pairs show motions during the scan they are used
    alone.
    """
    sinogram, angles_rad = np.asarray(sinogram, np.float64), np.asarray(angles_rad, np.float64)
    pairs = view_pair_fit(
        scanner, sinogram, angles_rad, start, rotation, deviations=deviations, interpolated=interpolated
    )
    opposite = _opposite_rays(scanner, sinogram, angles_rad, start, pairs)
    unlike = pairs.unrest > UNREST and pairs.deviation[0] > UNREST_CELLS * scanner.detector_pitch_mm
    jump = None if opposite is None else opposite.log_jump(scanner, start)
    if pairs.settled:
        if unlike and not pairs.hardened:
            raise DriftError(
                "moved-too-far",
                f"the views differ {math.sqrt(pairs.unrest):.2g} times more than noise and gains of the views explain: "
                "the log moved while it was scanned, or the angles are not those of the views; secure the log and scan "
                "again",
            )
        if jump is not None:
            raise DriftError(
                "moved-too-far",
                f"opposite rays differ as those of a log that moved by {jump.by_mm:.2g} mm while it was scanned, or of "
                "views with other angles than stated; secure the log and scan again",
            )
    elif opposite is None or jump is not None or not opposite.answers_alone(scanner):
        _refuse_unseen(scanner, pairs)
        raise DriftError(
            "moved-too-far",
            f"no geometry near the known one (u_c {start.cor_column_mm:.4g} mm) makes the views agree: the log "
            "moved while it was scanned, the calibration is another scanner's, or the geometry moved by more than "
            f"{REACH[0]:.0%} of the detector; calibrate with the phantom",
        )
    # Opposite rays do not know how certain the motion is that they were corrected for.
    fit = pairs if opposite is None or pairs.motion is not None else _combined(pairs, opposite)
    _refuse_unseen(scanner, fit)
    return fit


def _refuse_unseen(scanner: Scanner, fit: PairFit) -> None:
    pitch_mm, deviation_mm = scanner.detector_pitch_mm, float(fit.deviation[0])
    if not deviation_mm < pitch_mm * max(1.0, math.sqrt(fit.unrest)):
        raise DriftError(
            "nothing-seen",
            f"pairs of views place the centre of rotation to {deviation_mm:.2g} mm on the detector, which is more than "
            f"a cell of {pitch_mm:.3g} mm: average more rows, spread the views over more of the turn, or calibrate "
            "with the phantom",
        )


class _OppositeRays(NamedTuple):
    """The fit to opposite rays, the angles in its sense of rotation, and the corrections made to the views."""

    solution: Solution
    angles_rad: FloatArray
    done: tuple[str, ...]
    unrest: float  # variance of the differences of opposite rays, divided by the one that noise gives them

    @property
    def deviation_mm(self) -> float:
        """Standard deviation of u_c."""
        return math.sqrt(self.solution.covariance[0, 0])

    def answers_alone(self, scanner: Scanner) -> bool:
        """Return whether u_c is certain, and noise explains the differences, as after hardening but not a jump."""
        return self.deviation_mm < CERTAIN_CELLS * scanner.detector_pitch_mm and self.unrest < UNREST

    def log_jump(self, scanner: Scanner, start: SourceFrame) -> LogMovement | None:
        """Return the jump of a log that moved during the scan, if beyond chance and not a small part of a cell."""
        if self.angles_rad.size < FEWEST_JUMPED:
            return None
        jump = log_movement(self.solution, self.angles_rad, start.source_distance_mm)
        # Few opposite rays span the jump, so its covariance is uncertain: Hotelling's T-squared, not chi-squared.
        freedom = 2 * min(jump.view, self.angles_rad.size - jump.view) - 2
        by_chance = (1.0 + jump.chi_squared / freedom) ** (-0.5 * (freedom - 1))
        shortest_mm = SHORTEST_JUMP_CELLS * scanner.detector_pitch_mm / start.magnification
        return jump if by_chance < math.exp(-0.5 * CHANCE_OF_A_JUMP) and jump.by_mm > shortest_mm else None


def _opposite_rays(
    scanner: Scanner, sinogram: FloatArray, angles_rad: FloatArray, start: SourceFrame, pairs: PairFit
) -> _OppositeRays | None:
    """Fit opposite rays from the solution of the pairs; None if the views are not even, or the fit does not settle."""
    screening = pairs.screening
    angles = angles_rad[screening.views]
    if widest_gap_rad(angles) > WIDEST_GAP * TAU / angles.size:
        return None
    compared_all = angles.size <= MOST_VIEWS
    levelled = pairs.lines if compared_all else levelled_rays(screening.bridged(sinogram)[screening.views])
    rays = np.zeros((angles.size, scanner.num_detector_pixels))
    left_out = np.zeros(rays.shape, bool) if screening.hidden is None else screening.hidden[screening.views]
    rays[:, levelled.cells] = levelled.rays
    every = np.ones(angles.size, bool)
    vector = seen_vector(pairs if pairs.settled else start)
    if pairs.motion is not None:
        times = scan_times(len(sinogram))[screening.views]
        stated = pairs.rotation.apply(angles)
        turned = ScanMotions.of_scan(stated, times).turned_rad @ pairs.motion
        if np.abs(turned).max() > MOST_TURNED * TAU / angles.size:
            return None
        motions = ScanMotions.of_scan(stated + turned, times)
        # A log that moves across the beam by w moves rays by w / R of their fan angle (disturbances.undisturbed).
        swing = -(motions.moved_mm[0] @ pairs.motion) / start.source_distance_mm
        rays = shifted(scanner, vector, rays, swing)
        angles = pairs.rotation.apply(stated + turned + swing)
    even, first_rad = even_views(rays, angles, every)
    fan, _ = fan_angles(scanner, vector)
    gain = view_gain(even, fan, reversed_turn=pairs.rotation is Rotation.REVERSED)
    if gain is not None:
        even = gain.removed(even)
    rim_cells = np.abs(fan[levelled.cells]).max() / np.median(np.diff(fan))
    blur_cells = max(BLUR_CELLS, min(RIM_SHARE * TAU / angles.size, COARSEST) * float(rim_cells))
    # Beyond the detector is air, as at its ends: rays of the log's rim are compared too.
    air = math.ceil(CUT_OFF * blur_cells)
    wider = replace(scanner, num_detector_pixels=scanner.num_detector_pixels + 2 * air)
    turn = FullTurn.of(
        np.pad(even, ((0, 0), (air, air))),
        first_rad,
        angles,
        usable=every,
        bridged=np.pad(~screening.cells, air),
        left_out=np.pad(left_out, ((0, 0), (air, air))),
    )
    solution = Pairs(wider, turn.read(pairs.rotation), vector, (BLUR_VIEWS, blur_cells)).solve(
        vector, *reach(scanner, start), free=WITHOUT_DISTANCE, corrected=True
    )
    if not (solution.settled and np.isfinite(solution.free_covariance).all()):
        return None
    variance = np.zeros(scanner.num_detector_pixels)
    # A few masked rays with large errors must not excuse the differences of all others.
    variance[levelled.cells] = np.median(levelled.variance, axis=0)
    unrest = solution.pairs.unrest(solution.vector, np.pad(variance, air))
    return _OppositeRays(solution, pairs.rotation.apply(angles), () if gain is None else (gain.done,), unrest)


def _combined(pairs: PairFit, opposite: _OppositeRays) -> PairFit:
    """Combine both estimates of (u_c, tau), weighted by their covariances."""
    solution, estimates = opposite.solution, estimates_of(opposite.solution)
    of_disturbances = undetected_covariance(solution, estimates)
    # The uncertainty of the views' scatter enters by Student's t, as for pairs.
    wider = (scipy.special.stdtrit(opposite.angles_rad.size - 2, 0.975) / scipy.special.ndtri(0.975)) ** 2
    covariances = pairs.covariance[:2, :2], wider * (solution.covariance + of_disturbances)[:2, :2]
    # Pairs whose fit did not settle have no weight.
    precisions = [np.linalg.inv(each) for each in covariances]
    precisions[0] *= float(pairs.settled)
    covariance = np.linalg.inv(sum(precisions))
    of_pairs, of_opposite = (covariance @ each for each in precisions)
    column, tilt = of_pairs @ seen_vector(pairs)[:2] + of_opposite @ solution.vector[:2]
    # A flat field's error behind the log moves pairs alone: where both disagree, both are less certain than estimated.
    apart = seen_vector(pairs)[:2] - solution.vector[:2]
    disagreement = float(apart @ np.linalg.solve(covariances[0] + covariances[1], apart)) * float(pairs.settled)
    return replace(
        pairs,
        cor_column_mm=float(column),
        tilt_rad=float(tilt),
        covariance=np.pad(covariance * max(1.0, disagreement / BY_CHANCE), (0, 1)),
        distance_sensitivity=of_pairs @ pairs.distance_sensitivity + of_opposite @ solution.distance_sensitivity,
        encoder_bound_mm=_encoder_bound_mm(pairs, of_pairs, of_opposite, estimates),
        adjustments=(*pairs.adjustments, *opposite.done),
    )


def _encoder_bound_mm(
    pairs: PairFit, of_pairs: FloatArray, of_opposite: FloatArray, estimates: list[DisturbanceEstimate]
) -> float | None:
    """Return the largest change of u_c by an encoder's error of `ENCODER_DEG` once a turn, summed over estimates."""
    if pairs.encoder_bound_mm is None:
        return None
    once = Disturbance("encoder", 1)
    moved = [of_opposite[0] @ each.sensitivity for each in estimates if each.disturbance == once]
    by_opposite = math.radians(ENCODER_DEG) * float(sum(math.hypot(*each) for each in moved))
    return abs(float(of_pairs[0, 0])) * pairs.encoder_bound_mm + by_opposite
