"""Smooth structure of the flat field that stays in every view, as the air next to the log shows it.

A flat field taken on another day, or with another spectrum, is wrong by bumps some ten cells wide and more. The air
shows their size and width; behind the log they are modelled as a Gaussian process of the same covariance
(Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, sections 2.2 and 2.7).
"""

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FloatArray

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
    seen = rest @ of_air @ rest + noise**2 / group * np.eye(means.size)
    weights = np.linalg.solve(seen, shared.T).T
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
    variances = np.sum(weights * noises * ratios, axis=1) / weights.sum()
    smooth: FloatArray = variances @ bumps
    return smooth
