"""Pairs of views: sums that any two fan-beam views of one body have in common, however few views there are.

Let L be the line through the sources of two views, and let it miss the body. A view's rays p(gamma), summed as
p dgamma / cos(angle to L's normal), are the integral of f(x) / dist(x, L) over the plane, since dA = r dr dgamma and
dist(x, L) = r cos(that angle): the same for both. With gamma as in docs/look-up/conventions.md#source-frame and 2
delta the angle from the first view to the second,

    int p_1 dgamma / cos(gamma + delta) = int p_2 dgamma / cos(gamma - delta).

These are the pair conditions of fan-beam data with which Clackdoyle, Desbat, Lesaint and others calibrate. They are
linear in the rays, so the rows of a log may be averaged first, and R is not in them
(docs/understand/drift.md#sparse-scans).
"""

import math
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.drift.change import DetectorFit, DriftError, better_sense, seen_vector
from sawmill_tomography.drift.levelled_rays import LevelledRays, levelled_rays
from sawmill_tomography.drift.log_screening import LogScreening, screen_log
from sawmill_tomography.drift.view_pairs.behind_metal import RaysBehindMetal, rays_behind_metal
from sawmill_tomography.drift.view_pairs.pair_sums import MotionSizes, PairSums, ScanMotions, motion_sizes
from sawmill_tomography.geometry.geometry import FloatArray, GeometryError, Scanner, SourceFrame
from sawmill_vocabulary import FEWEST_PAIRED_VIEWS, Rotation

# How far u_c (share of the detector) and tau (rad) may have moved and are still followed: less than EDGE_RAD allows.
REACH = (0.03, 0.2)
# The sense of rotation is decided where the other sense leaves this many times the residual.
DECISIVE = 2.0
STEPS = 8
SMALL_STEP = 1e-2
# Below this share of the largest a direction in the space of gains is rounding.
RANK = 1e-6
# A pattern below this share of the noise cannot be seen.
SHOWN = 0.3
# Bends and the encoder's error are in every fit: this number of patterns.
ALWAYS = 4
# Motions are fitted at most this number of times, from corrected angles and u_c, until corrections are small.
ROUNDS, SMALL_TURN_RAD, SMALL_SHIFT_MM = 4, 1e-3, 0.05
# Step of the turn's amplitude for the derivative of what other motions do.
TURN_STEP = 0.01
# Turns that are tried at first, as amplitudes.
TRIED = np.linspace(-1.5, 1.5, 5)
# A pattern larger than this number of its assumed standard deviations is rejected.
LARGEST = 4.0
# Views with a larger variance ratio are not explained by noise and gains. They are hardened by more than `BENT` if that
# number of times as much explains them; otherwise the body did not keep still.
UNREST, HARDENED = 25.0, 10.0
HARDENING_SEEN = (
    "the views differ more than noise and gains of the views explain, as where the beam hardens by far more than a "
    "tenth: the standard deviations are as large as that asks for"
)
# Largest number of views compared, spread evenly: `MOST_PAIRS` pairs among more views would leave each view's gain
# unknown, and the interval too short (benchmarks/drift_coverage.py at 3ab7f653).
MOST_VIEWS = 45
# Smallest number of comparisons, not explained by anything else, that give the noise: Student's t then doubles
# intervals.
FEWEST_FREE = 2


@dataclass(frozen=True, eq=False, kw_only=True)
class PairFit(DetectorFit):
    """The detector's geometry by pairs of views."""

    settled: bool  # True if u_c and tau converged near the calibrated ones
    unrest: float  # variance of the differences that no gain explains, divided by the variance of the rays' noise
    hardened: bool  # True if `unrest` is above `UNREST`, and line integrals bent by more than `BENT` would explain it
    screening: LogScreening  # views, cells and samples that may be used
    lines: LevelledRays  # rays of the views that were compared: all usable views, or `MOST_VIEWS` of them
    motion: FloatArray | None  # (motions,) or None


def view_pair_fit(
    scanner: Scanner,
    sinogram: FloatArray,
    angles_rad: FloatArray,
    start: SourceFrame,
    rotation: Rotation,
    *,
    deviations: FloatArray | None = None,
    interpolated: NDArray[np.bool_] | None = None,
) -> PairFit:
    """Fit u_c and tau to the common sums of pairs of views, SDD held.

    Parameters
    ----------
    sinogram, angles_rad, start, rotation
        Parameters of `conjugate_fit`, but with any views, and with air on both sides of the body in each of them.
    deviations : (views, detector) float64, optional
        Standard deviations of the line integrals, which weight them. Where it is 0 the standard deviation is estimated
        from the air; None: everywhere.
    interpolated : (detector,) bool, optional
        True for cells that were interpolated in every view, as across a gap between modules.

    Raises
    ------
    DriftError
        If there are too few views, or the log reaches an end of the detector.
    GeometryError
        If the deviations have another shape than the sinogram, or are negative or not finite.
    """
    sinogram, angles_rad = np.asarray(sinogram, np.float64), np.asarray(angles_rad, np.float64)
    screening = screen_log(scanner, sinogram, rotation.apply(angles_rad), start)
    usable = int(screening.views.sum())
    if usable < FEWEST_PAIRED_VIEWS:
        raise DriftError(
            "sparse-views",
            f"{usable} usable views are too few to be compared: {FEWEST_PAIRED_VIEWS} are needed, all round or not",
        )
    compared = np.flatnonzero(screening.views)
    adjustments = screening.adjustments
    if usable > MOST_VIEWS:
        compared = compared[np.linspace(0, usable - 1, MOST_VIEWS).round().astype(int)]
        adjustments = (*adjustments, f"{MOST_VIEWS} of {usable} views were compared, spread evenly over them")
    angles_rad = angles_rad[compared]
    known_deviations = None if deviations is None else _checked(deviations, sinogram)[compared]
    rays = screening.bridged(sinogram)[compared]
    views = _ComparedViews(
        scanner,
        rays,
        None if screening.hidden is None else screening.hidden[compared],
        known_deviations,
        None if interpolated is None else np.broadcast_to(interpolated, rays.shape),
    )
    metal, lines = views.read(rotation.apply(angles_rad), start)
    vector, distance_mm = seen_vector(start), start.source_distance_mm
    times = scan_times(len(sinogram))[compared]
    sums = {
        sense: PairSums.of(scanner, lines, metal, sense.apply(angles_rad), vector, distance_mm) for sense in Rotation
    }
    fits = {sense: _fit(each, vector, vector) for sense, each in sums.items()}
    residuals = {sense: math.sqrt(fit.chi_squared) for sense, fit in fits.items()}
    given = rotation
    rotation, ratio = better_sense(residuals, given, DECISIVE)
    common = sums[rotation]
    near, fit = _with_disturbances(common, vector, times, fits[rotation])
    if metal.of_view.size and (fit.motion is not None or rotation is not given):
        # With the angles as they were given the log behind the metal was blurred.
        angles = common.angles_rad
        if fit.motion is not None:
            angles = angles + ScanMotions.of_scan(angles, times).turned_rad @ fit.motion
        there = replace(start, cor_column_mm=float(fit.vector[0]), tilt_rad=float(fit.vector[1]))
        metal, lines = views.read(angles, there)
        common = PairSums.of(scanner, lines, metal, common.angles_rad, vector, distance_mm)
        near, fit = _with_disturbances(common, vector, times, _fit(common, vector, vector))
    motion = fit.motion
    if motion is not None:
        adjustments = (*adjustments, ScanMotions.of_scan(common.angles_rad, times).described(motion))
    hardened = False
    if fit.settled and fit.unrest > UNREST:
        hardened = _disturbed(common, vector, near, times, fit, hardened=HARDENED).unrest <= UNREST
        adjustments = (*adjustments, HARDENING_SEEN) if hardened else adjustments
    return PairFit(
        float(fit.vector[0]),
        float(fit.vector[1]),
        start.source_to_detector_mm,
        np.pad(fit.covariance, (0, 1)),
        distance_held=True,
        rotation=rotation,
        rotation_ratio=ratio,
        relative_residual=fit.relative_residual,
        distance_sensitivity=fit.distance_sensitivity,
        rotation_decided=ratio > DECISIVE,
        adjustments=adjustments,
        encoder_bound_mm=fit.encoder_bound_mm,
        settled=fit.settled,
        unrest=fit.unrest,
        hardened=hardened,
        screening=screening,
        lines=lines,
        motion=motion,
    )


@dataclass(frozen=True, eq=False)
class _ComparedViews:
    """The views that are compared."""

    scanner: Scanner
    rays: FloatArray  # (views, detector): line integrals without faulty cells
    metal: NDArray[np.bool_] | None  # (views, detector) bool or None
    deviations: FloatArray | None  # (views, detector) or None: standard deviations of the line integrals
    interpolated: NDArray[np.bool_] | None  # (views, detector) bool or None

    def read(self, angles_rad: FloatArray, frame: SourceFrame) -> tuple[RaysBehindMetal, LevelledRays]:
        """Return the rays with those behind metal, as the views at these angles see the log, and all levelled."""
        behind = rays_behind_metal(self.scanner, self.rays, angles_rad, frame, self.metal)
        return behind, levelled_rays(behind.rays, self.deviations, self.interpolated)


def _checked(deviations: FloatArray, sinogram: FloatArray) -> FloatArray:
    deviations = np.asarray(deviations, np.float64)
    if deviations.shape != sinogram.shape:
        raise GeometryError(
            f"the standard deviations have shape {deviations.shape}, but the line integrals {sinogram.shape}: give one "
            "of each line integral"
        )
    if not ((deviations >= 0.0) & np.isfinite(deviations)).all():
        raise GeometryError(
            "the standard deviations of line integrals must be positive and finite, or 0 where none is known"
        )
    return deviations


class _MotionEffects(NamedTuple):
    """Effects of motions on the differences of a scan whose angles were corrected."""

    changes: FloatArray  # (pairs, motions): change of the differences by one standard deviation of the largest motions
    kinds: tuple[str, ...]  # the kind of each motion
    corrected: FloatArray  # (motions,)


class _PairSumsFit(NamedTuple):
    """A fit of u_c and tau in one sense of rotation, (2,), with SDD held."""

    vector: FloatArray
    covariance: FloatArray  # (2, 2)
    distance_sensitivity: FloatArray  # (2,): change of u_c and tau per mm of SDD
    chi_squared: float
    unrest: float  # variance of the differences that no gain explains, divided by the variance of the rays' noise
    relative_residual: float
    encoder_bound_mm: float  # largest change of u_c by an encoder's error of `ENCODER_DEG`
    largest_pattern: float  # largest amplitude of the fitted patterns, in assumed standard deviations
    settled: bool  # True if u_c and tau converged inside the reach
    amplitudes: FloatArray  # (motions,): amplitudes of the motions, empty without motions
    sizes: MotionSizes | None  # sizes of the motions that the fit allows for

    @property
    def motion(self) -> FloatArray | None:
        """The amplitudes of the motions, if motions are far more likely than none."""
        return self.amplitudes if self.settled and self.sizes is not None and self.sizes.found else None


def scan_times(views: int) -> FloatArray:
    """Return the times of a scan's views, (views,), from -0.5 to 0.5."""
    return np.linspace(-0.5, 0.5, views)


def _with_disturbances(
    sums: PairSums, calibrated: FloatArray, times: FloatArray, undisturbed: _PairSumsFit
) -> tuple[FloatArray, _PairSumsFit]:
    """Return where the fit with disturbances starts, from the one without, and the fit."""
    near = np.append(undisturbed.vector, calibrated[2]) if undisturbed.settled else calibrated
    # Views that do not settle, and are too few for disturbances, are refused for what they are.
    fit = undisturbed
    with nullcontext() if undisturbed.settled else suppress(DriftError):
        fit = _disturbed(sums, calibrated, near, times, undisturbed)
    return near, fit


def _disturbed(
    sums: PairSums,
    calibrated: FloatArray,
    near: FloatArray,
    times: FloatArray,
    undisturbed: _PairSumsFit,
    *,
    hardened: float = 1.0,
) -> _PairSumsFit:
    """Fit from `near` with disturbances; `undisturbed` where they are larger than possible, or nothing settles."""
    motions = ScanMotions.of_scan(sums.angles_rad, times)
    amplitudes = np.zeros(len(motions.kinds))
    if undisturbed.unrest > UNREST:
        amplitudes = _likely_turn(sums, near, motions, hardened)
    start, fit = near, undisturbed
    for _ in range(ROUNDS):
        turned, before = sums.turned(motions.turned_rad @ amplitudes), fit.motion
        fit = _fit(turned, calibrated, start, motions=_effects(turned, start, times, amplitudes), hardened=hardened)
        further_rad = motions.turned_rad @ (fit.amplitudes - amplitudes)
        shift_mm = abs(fit.vector[0] - start[0])
        start, amplitudes = np.append(fit.vector, near[2]), fit.amplitudes
        if np.abs(further_rad).max() < SMALL_TURN_RAD and shift_mm < SMALL_SHIFT_MM:
            break
    else:  # Motions that come and go from round to round are not the scan's.
        fit = fit._replace(sizes=None) if before is None else fit
    return fit if fit.settled and fit.largest_pattern < LARGEST else undisturbed


def _effects(sums: PairSums, vector: FloatArray, times: FloatArray, amplitudes: FloatArray) -> _MotionEffects:
    """Return the effects of motions near these amplitudes, (motions,), for whose turn the sums were corrected.

    The axis wobbles with the true angle, and a log slides with it: a further turn also changes what other motions do.
    """
    motions = ScanMotions.of_scan(sums.angles_rad, times)
    turn, others = amplitudes * motions.turns, amplitudes * ~motions.turns
    changes = sums.moved(vector, motions)
    if others.any():
        further = sums.turned(TURN_STEP * motions.turned_rad.sum(axis=1))
        by_turn = further.moved(vector, ScanMotions.of_scan(further.angles_rad, times)) @ others - changes @ others
        changes[:, motions.turns] += by_turn[:, None] / TURN_STEP
    return _MotionEffects(changes, motions.kinds, turn)


def _likely_turn(sums: PairSums, near: FloatArray, motions: ScanMotions, hardened: float) -> FloatArray:
    """Return the amplitudes (motions,) of the turn, of `TRIED` ones, that leaves least of the differences.

    Sums are not linear in turns of degrees. The other motions are as large as they can be.
    """
    turns = TRIED[:, None] * motions.turns
    left = []
    for turn in turns:
        turned = sums.turned(motions.turned_rad @ turn)
        differences, others = turned.differences(near), ~motions.turns * turned.moved(near, motions)
        white, _ = turned.whitening(near, np.hstack([hardened * turned.bends(near), others]))
        slopes = np.linalg.qr(white @ turned.slopes(near, differences, 2))[0]
        white_differences = white @ differences
        left.append(float(np.sum((white_differences - slopes @ (slopes.T @ white_differences)) ** 2)))
    return np.asarray(turns[int(np.argmin(left))])


def _fit(
    sums: PairSums,
    calibrated: FloatArray,
    start: FloatArray,
    *,
    motions: _MotionEffects | None = None,
    hardened: float = 1.0,
) -> _PairSumsFit:
    """Fit the pairs' differences by generalised least squares, with Gauss-Newton from the start.

    With `motions` the fit allows for bent line integrals, `hardened` times as much as usual, for an eccentric encoder
    and for motions during the scan, as large as the differences show.
    """
    width = sums.scanner.num_detector_pixels * sums.scanner.detector_pitch_mm
    low, high = (calibrated[:2] + side * np.array(REACH) * [width, 1.0] for side in (-1.0, 1.0))
    encoder = sums.moved(start, ScanMotions.encoder(sums.angles_rad))
    patterns = encoder[:, :0]
    if motions is not None:
        patterns = np.hstack([hardened * sums.bends(start), math.sqrt(0.5) * encoder])
    white, gains = sums.whitening(start, patterns)
    sizes, put_back = None, np.zeros(len(gains))
    if motions is not None:
        differences, put_back = sums.differences(start), motions.changes @ motions.corrected
        explained = _explained(white @ sums.slopes(start, differences, 2), white @ gains)
        sizes = motion_sizes(white @ (differences + put_back), explained, white @ motions.changes, motions.kinds)
        changes = motions.changes * sizes.shares
        patterns = np.hstack([patterns, changes])
        # `white` whitens the changes too, whose standard deviation is 1.
        space, size, _ = np.linalg.svd(white @ changes, full_matrices=False)
        white = white + space * (1.0 / np.sqrt(1.0 + size**2) - 1.0) @ (space.T @ white)
    vector, settled = start, False
    for _ in range(STEPS):
        differences = sums.differences(vector)
        slopes = white @ sums.slopes(vector, differences, 2)
        covariance = np.linalg.inv(slopes.T @ slopes)
        moved = np.clip(vector[:2] - covariance @ slopes.T @ (white @ (differences + put_back)), low, high)
        small = np.abs(moved - vector[:2]) <= SMALL_STEP * np.sqrt(np.diag(covariance))
        vector = np.append(moved, start[2])
        if small.all():
            settled = bool(((low < moved) & (moved < high)).all())
            break
    left, right = sums.at(vector)
    slopes = white @ sums.slopes(vector, left - right, 3)
    remaining, shown = white @ (left - right + put_back), white @ patterns
    of_flat_field = white @ sums.common_covariance(start) @ white.T
    scaled, chi_squared, unrest = _scaled(remaining, slopes[:, :2], white @ gains, shown, of_flat_field)
    moving = np.linalg.pinv(slopes[:, :2])
    sensitivity: FloatArray = -moving @ slopes[:, 2]
    by_encoder = moving[0] @ white @ encoder
    residual = float(np.sqrt(np.mean((left - right) ** 2) / np.mean(left**2)))
    amplitudes = shown.T @ remaining
    if sizes is not None:
        amplitudes[ALWAYS:] *= sizes.shares
    return _PairSumsFit(
        vector[:2],
        scaled,
        sensitivity,
        chi_squared,
        unrest,
        residual,
        math.hypot(*by_encoder),
        float(np.abs(amplitudes).max(initial=0.0)),
        settled,
        amplitudes[ALWAYS:],
        sizes,
    )


def _explained(slopes: FloatArray, gains: FloatArray) -> FloatArray:
    """Return orthonormal columns for all that slopes and gains explain."""
    space, size, _ = np.linalg.svd(np.hstack([slopes / np.linalg.norm(slopes, axis=0), gains]), full_matrices=False)
    return space[:, size > RANK * size[0]]


def _scaled(
    residual: FloatArray, slopes: FloatArray, gains: FloatArray, patterns: FloatArray, of_flat_field: FloatArray
) -> tuple[FloatArray, float, float]:
    """Return the covariance (2, 2) scaled to the residual of the whitened differences, chi-squared, and `unrest`.

    Noise and gains have a scale each: gains of another size than assumed say nothing about the noise, which is the
    residual that no gain explains. The flat field's part (differences, differences) is known from the air: a residual
    below the noise that was assumed makes it no smaller. The uncertainty of each scale enters by Student's t. Patterns
    explain no more than their size allows, but each bend that can be seen is one comparison less, and motions are as
    many as they explain.
    """
    covariance = np.linalg.inv(slopes.T @ slopes)
    explained = _explained(slopes, gains)
    of_gains = explained.shape[1] - slopes.shape[1]
    of_bends, of_motions = np.split(np.linalg.norm(patterns, axis=0), [ALWAYS])
    free = len(residual) - explained.shape[1] - int(np.sum(of_bends > SHOWN))
    if free > FEWEST_FREE:
        # Motions take their share of a comparison each, but a scan that hardly shows them is not refused for them.
        free = max(free - float(np.sum(of_motions**2)), FEWEST_FREE)
    if free < FEWEST_FREE:
        raise DriftError(
            "sparse-views",
            f"the views' pairs leave {max(free, 0)} comparisons that no gain of a view explains, and {FEWEST_FREE} are "
            "needed to tell how sure they are: take more views",
        )
    chi_squared = float(residual @ residual)
    noise = chi_squared - float(np.sum((explained.T @ residual) ** 2))
    to_unknowns = covariance @ slopes.T
    through = to_unknowns @ gains
    by_gains = through @ through.T
    widths = [
        chi / number * (scipy.special.stdtrit(number, 0.975) / scipy.special.ndtri(0.975)) ** 2
        for chi, number in ((noise, free), (chi_squared - noise, of_gains))
    ]
    by_flat_field = max(0.0, 1.0 - widths[0]) * (to_unknowns @ of_flat_field @ to_unknowns.T)
    scaled = widths[0] * (covariance - by_gains) + widths[1] * by_gains + by_flat_field
    return scaled, chi_squared, noise / free
