"""A log's rays corrected by the air next to the log: each view's level, and the flat field's slope and bend.

Smooth structure of the flat field that stays in every view, as the air next to the log shows it. A flat field taken
on another day, or with another spectrum, is wrong by bumps some ten cells wide and more. The air shows their size and
width; behind the log they are modelled as a Gaussian process of the same covariance (Rasmussen and Williams, Gaussian
Processes for Machine Learning, 2006, sections 2.2 and 2.7).
"""

import math
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.drift.change import DriftError
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.sinograms.air import find_air
from sawmill_tomography.sinograms.present_rows import bridged_samples
from sawmill_tomography.statistics import noise_of_differences

# Lower bound of a ray's noise in air, as a share of the largest line integral: for noise-free data.
LEAST_NOISE = 1e-4


class LevelledRays(NamedTuple):
    """Line integrals through the log, their variance, their cells, and the errors of the air's fit."""

    rays: FloatArray  # (views, cells): values in the log's cells alone
    variance: FloatArray  # (views, cells)
    cells: NDArray[np.bool_]  # (detector,) bool: True where a cell is not air
    air_patterns: FloatArray  # (3, cells): A slope, a curvature and a cubic over the detector, in the log's cells
    air_covariance: FloatArray  # (views + 3, views + 3)
    common_covariance: FloatArray  # (cells, cells)


class AirFit(NamedTuple):
    """Levels and patterns fitted to the air on both sides of the log."""

    cells: NDArray[np.bool_]  # (detector,) bool: True where a cell is air in every view
    patterns: FloatArray  # (3, detector): A slope, a curvature and a cubic over the detector
    amplitudes: FloatArray  # (3,): amplitudes of the patterns
    levels: FloatArray  # (views,)
    covariance: FloatArray  # (views + 3, views + 3): covariance of levels and amplitudes, for rays whose variance is 1

    @property
    def of_all_views(self) -> FloatArray:
        """The flat field's part in the rays of every view, (detector,), apart from a level."""
        return self.amplitudes @ self.patterns


def fitted_air(sinogram: FloatArray, scale: FloatArray | float = 1.0) -> AirFit | None:
    """Fit a level per view and three common patterns to the air; None without air at both ends, or without a log.

    `sinogram` (views, detector): line integrals without faulty cells and corrupt views. `scale` (views, 1): relative
    noise of each view: air is found by its scatter.
    """
    air = find_air((sinogram / scale).astype(np.float32))
    if air is None or air.cells.all() or not (air.cells[0] and air.cells[-1]):
        return None
    views = len(sinogram)
    across = np.linspace(-1.0, 1.0, air.cells.size)
    patterns = np.stack([across, across**2, across**3])
    means = patterns[:, air.cells].mean(axis=1)
    # The patterns are fitted to the residual without the levels, which share their error.
    centred = patterns[:, air.cells] - means[:, None]
    of_patterns = np.linalg.inv(centred @ centred.T) / views
    amplitudes = of_patterns @ (centred @ sinogram[:, air.cells].sum(axis=0))
    levels = sinogram[:, air.cells].mean(axis=1) - amplitudes @ means
    crossed = np.tile(-(of_patterns @ means)[:, None], views)
    of_levels = np.eye(views) / int(air.cells.sum()) + means @ of_patterns @ means
    return AirFit(air.cells, patterns, amplitudes, levels, np.block([[of_levels, crossed.T], [crossed, of_patterns]]))


def levelled_rays(
    sinogram: FloatArray, deviations: FloatArray | None = None, interpolated: NDArray[np.bool_] | None = None
) -> LevelledRays:
    """Subtract each view's level and the common patterns, fitted to the air on both sides, from the log's rays.

    `sinogram` (views, detector): line integrals without faulty cells and corrupt views. `deviations` (views, detector):
    standard deviations of the line integrals. Where it is 0 the standard deviation is estimated; None: everywhere.
    `interpolated` (views, detector) bool: True for samples that were interpolated along the detector.
    """
    known_deviations = np.zeros_like(sinogram) if deviations is None else deviations
    all_known = bool(known_deviations.all())
    scale = np.median(known_deviations, axis=1, keepdims=True) / np.median(known_deviations) if all_known else 1.0
    air = fitted_air(sinogram, scale)
    if air is None:
        raise _no_air(sinogram)
    levelled = sinogram - air.levels[:, None] - air.of_all_views
    in_air, cell_variance = _scatter(levelled[:, air.cells])
    if all_known:
        in_air = float(np.sqrt(np.mean(known_deviations[:, air.cells] ** 2)))
    noise = max(in_air, LEAST_NOISE * float(sinogram.max()))
    log = ~air.cells
    structure = flat_structure(
        levelled.mean(axis=0), air.cells, air.patterns, cell_variance, noise / math.sqrt(len(levelled))
    )
    rays = levelled[:, log] - structure.expected
    variance = (
        known_deviations[:, log] ** 2
        if all_known
        else np.maximum(_variance(rays, noise), known_deviations[:, log] ** 2)
    )
    if interpolated is not None:
        own = interpolated[:, log]
        variance = np.maximum(variance, np.where(own, _interpolation_variance(rays, own), 0.0))
    return LevelledRays(rays, variance, log, air.patterns[:, log], noise**2 * air.covariance, structure.covariance)


def _interpolation_variance(rays: FloatArray, interpolated: NDArray[np.bool_]) -> FloatArray:
    """Return the variance (views, 1) of interpolated samples that gives their sum in a view its error.

    The same samples, shifted along the detector, are interpolated where the rays are known. The error of a view's sum
    grows with the number n of its samples: its square is kappa n^2, which is a variance of kappa n for each of them.
    """
    number = interpolated.sum(axis=1, keepdims=True)
    squares, numbers = 0.0, 0
    for shift in (int(number.max()) + 1) * np.array([-3, -2, -1, 1, 2, 3]):
        moved = np.roll(interpolated, shift, axis=1)
        moved[:, slice(0, shift) if shift > 0 else slice(shift, None)] = False
        moved[(moved & interpolated).any(axis=1) | (moved.sum(axis=1) < number[:, 0])] = False
        squares += float(np.sum(np.sum(bridged_samples(rays, moved) - rays, axis=1) ** 2))
        numbers += int(np.sum(moved.sum(axis=1) ** 2))
    return np.asarray(number * (squares / max(numbers, 1)))


def _no_air(sinogram: FloatArray) -> DriftError:
    air = find_air(sinogram.astype(np.float32))
    if air is not None and air.cells.all():
        return DriftError("nothing-seen", "there is air in every cell and no log: scan a log while it turns")
    return DriftError(
        "log-cut-off",
        "the log reaches an end of the detector: pairs of views need air on both sides of it in every view",
    )


def _scatter(air: FloatArray) -> tuple[float, float]:
    """Return the noise of rays in air (views, cells), and the variance of what their cells add to every view."""
    views, common = len(air), air.mean(axis=0)
    noise = noise_of_differences(np.diff(air - common, 2, axis=1), 2) * math.sqrt(views / (views - 1))
    return noise, max(noise_of_differences(np.diff(common, 2), 2) ** 2 - noise**2 / views, 0.0)


def _variance(rays: FloatArray, air_noise: float) -> FloatArray:
    """Estimate each ray's variance: the air's times exp(k p), k between 0 (uniform noise) and 1 (photon noise).

    The second differences give k. The log's structure counts as noise in them, so k is an upper bound; errors fitted
    with this variance are as wide as their residuals. The variance is capped where the noise would exceed the largest
    ray.
    """
    seen = noise_of_differences(np.diff(rays, 2, axis=1), 2)
    k = min(max(2.0 * math.log(max(seen, 1e-30) / air_noise) / max(float(np.median(rays)), 1e-6), 0.0), 1.0)
    return air_noise**2 * np.exp(np.clip(k * rays, 0.0, 2.0 * math.log(max(float(rays.max()) / air_noise, 1.0))))


# The air's cells are averaged in groups to about this number of them, which costs milliseconds.
GROUPS = 100
# A smaller number of groups does not show a structure.
FEWEST_GROUPS = 12
# Lengths l of a bump exp(-d^2 / 2 l^2) that are compared, from this number of groups up to a share of the detector:
# a longer bump is a slope, a curvature or a cubic.
SHORTEST, LONGEST, LENGTHS = 0.75, 0.1, 8
# Variances of the bumps that are compared, as shares of a group's noise variance; no bumps has as much weight as all.
VARIANCES = np.geomspace(1e-2, 1e6, 41)


class FlatStructure(NamedTuple):
    """Structure that remains in every view behind the log."""

    expected: FloatArray  # (cells,): expected structure, near the log's edges, where the air shows it
    covariance: FloatArray  # (cells, cells): covariance of the remainder after the expected structure is subtracted


def flat_structure(
    common: FloatArray, air: NDArray[np.bool_], patterns: FloatArray, cell_variance: float, noise: float
) -> FlatStructure:
    """Predict the structure behind the log from the air.

    `common` (detector,): the mean over the views, less a level and patterns that were fitted to the air. `air`
    (detector,) bool: True in air; the log is in the other cells, which are contiguous. `patterns` (patterns, detector).
    """
    group = -(-int(air.sum()) // GROUPS)
    first = group * np.flatnonzero(air[: air.size // group * group].reshape(-1, group).all(axis=1))
    cells = first[:, None] + np.arange(group)
    log = np.flatnonzero(~air)
    shapes = np.vstack([np.ones(air.size), patterns])
    means, grouped, behind = common[cells].mean(axis=1), shapes[:, cells].mean(axis=2), shapes[:, log]
    # Half cells, so that the middle of a group is an integer.
    middles, places = 2 * first + group - 1, 2 * log
    smooth = _smooth_covariance(means, grouped, middles, group, air.size)
    of_log = scipy.linalg.toeplitz(smooth[: 2 * log.size : 2])
    of_air, crossed = (smooth[np.abs(one[:, None] - middles)] for one in (middles, places))
    of_log[np.diag_indices_from(of_log)] += cell_variance
    of_air[np.diag_indices_from(of_air)] += cell_variance / group
    # Level and patterns absorb a part of the structure, in the air and behind the log.
    fit = np.linalg.pinv(grouped.T)
    uncorrected = crossed - behind.T @ (fit @ of_air)
    taken = (0.5 * (crossed + uncorrected) @ fit.T) @ behind
    rest, shared = np.eye(means.size) - grouped.T @ fit, uncorrected - (uncorrected @ grouped.T) @ fit
    weights = np.linalg.solve(rest @ of_air @ rest + noise**2 / group * np.eye(means.size), shared.T).T
    return FlatStructure(weights @ means, of_log - taken - taken.T - weights @ shared.T)


def _smooth_covariance(
    means: FloatArray, shapes: FloatArray, middles: NDArray[np.intp], group: int, detector: int
) -> FloatArray:
    """Estimate the covariance by distance, (2 detector,) in half cells, from means of groups of the air's cells.

    The likelihood is restricted (Harville 1977, Journal of the American Statistical Association 72, 320): of what no
    level and pattern explains. Lengths and variances count with their likelihood, so that their uncertainty from few
    bumps enlarges the covariance.
    """
    # Air without noise comes from a simulation.
    if means.size < FEWEST_GROUPS or not means.any():
        return np.zeros(2 * detector)
    free = np.linalg.qr(shapes.T, mode="complete")[0][:, len(shapes) :]
    residual, number = free.T @ means, free.shape[1]
    lengths = np.geomspace(SHORTEST * group, max(LONGEST * detector, SHORTEST * group), LENGTHS)
    bumps = np.exp(-0.5 * (0.5 * np.arange(2 * detector) / lengths[:, None]) ** 2)
    apart = np.abs(middles[:, None] - middles)
    ratios = np.append(0.0, VARIANCES)
    likelihoods, noises = np.empty((2, LENGTHS, ratios.size))
    for at, bump in enumerate(bumps):
        spread, directions = np.linalg.eigh(free.T @ bump[apart] @ free)
        factors = 1.0 + np.outer(ratios, np.maximum(spread, 0.0))
        squares = np.sum((directions.T @ residual) ** 2 / factors, axis=1)
        noises[at] = squares / (number - 2)
        likelihoods[at] = -0.5 * np.log(factors).sum(axis=1) - 0.5 * number * np.log(squares)
    weights = np.exp(likelihoods - likelihoods.max())
    weights[:, 0] *= VARIANCES.size
    return np.asarray((np.sum(weights * noises * ratios, axis=1) / weights.sum()) @ bumps)
