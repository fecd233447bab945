"""Scattered radiation: fitted to a phantom's scan with its hardening, and corrected in a log's line integrals.

An object removes the share 1 - P of the intensity from the beam, where P = exp(-p). A part of it reaches other cells:
I = P + S with S = around H[1 - P] + wide mean(1 - P), the halo H a running mean along the row, taken twice.

Beam hardening: fitted to a phantom's scan, and corrected in the line integrals of a log's scan. Where the attenuation
over the beam's spectrum follows a gamma distribution of mean 1 and variance v, a line integral p is measured as m =
-ln E[exp(-a p)] = ln(1 + v p) / v: the logarithm of the distribution's Laplace transform. One number describes any
spectrum well enough, extrapolates sensibly beyond the phantom's longest path, and is not affected by small errors of
a drawing, as the powers of p are.
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary.scattered_radiation import BeamCorrection, BeamHardening, ScatteredRadiation

# Width of the halo's running mean, in cells.
HALO = 45
# Views that the fit uses: three unknowns of the beam need no more.
VIEWS = 24
MOST = 0.45
# Scatter leaves as much power as the freer fit, or 1.6 times as much if its halo is half as wide; 2 % of glare
# leaves 6 times as much (tests/calibration/test_beam.py).
MOST_LEFT = 2.0
# Each repetition leaves about `around + wide` of the error, and the first estimate is right where the scatter is
# smooth.
REPETITIONS = 2


def halo(values: FloatArray, width_cells: int = HALO) -> FloatArray:
    """Spread values along the row."""
    for _ in range(2):
        values = scipy.ndimage.uniform_filter1d(values, width_cells, axis=-1, mode="nearest")
    return values


def scattered(scatter: ScatteredRadiation, lost: FloatArray) -> FloatArray:
    """Compute the scatter that reaches the cells (..., cells) from the intensity lost in them, both relative to air."""
    added: FloatArray = scatter.around * halo(lost, scatter.width_cells)
    added += scatter.wide * lost.mean(axis=-1, keepdims=True)
    return added


def with_scatter(scatter: ScatteredRadiation, primary: FloatArray) -> FloatArray:
    """Compute the measured line integrals from line integrals of the primary beam (..., cells)."""
    intensity = np.exp(-primary)
    return -np.log(intensity + scattered(scatter, 1.0 - intensity))


def without_scatter(scatter: ScatteredRadiation, measured: NDArray[np.float32]) -> NDArray[np.float32]:
    """Compute the line integrals of the primary beam from measured ones above the air's level (..., cells).

    S is linear in the intensities: S = K (1 - I + S). The noise of a line integral grows with I / P, which is limited
    to STEEPEST as it is for hardening.
    """
    intensity = np.exp(-measured)
    added = scattered(scatter, 1.0 - intensity) / (1.0 - scatter.around - scatter.wide)
    for _ in range(REPETITIONS):
        added = scattered(scatter, 1.0 - intensity + added)
    return np.asarray(-np.log(np.maximum(intensity - added, intensity / STEEPEST)), np.float32)


def fit_scatter_and_hardening(
    lengths_mm: FloatArray, integrals: FloatArray, residual: FloatArray, weights: FloatArray | None
) -> BeamCorrection | None:
    """Fit background, attenuation, hardening and scatter to line integrals of known paths that were made from counts.

    None where the scan does not show such scatter, but glare in the detector, or a beam that passes by the phantom.

    `lengths_mm`, `integrals`, `residual` (views, cells): paths through the phantom, their measured line integrals
    without blur and other effects, and the residual of a fit that is free to be unphysical. `weights` (views, cells) or
    None: samples without weight do not count.
    """
    some = slice(None, None, max(1, len(lengths_mm) // VIEWS))
    lengths, measured = lengths_mm[some], integrals[some]
    counted = np.isfinite(measured) if weights is None else weights[some] > 0.0
    longest_mm = float(lengths_mm.max())

    def misfit(x: FloatArray) -> FloatArray:
        background, attenuation, bend, around, wide = x
        primary = background + attenuation * np.log1p(bend * lengths) / bend
        return (with_scatter(ScatteredRadiation(around, wide, HALO), primary) - measured)[counted]

    # Bend is spread times attenuation, per mm (`hardening.fit_hardening`).
    through = counted & (lengths > 0.1 * longest_mm)
    least, steep = LEAST_CHANGE / longest_mm, float(np.median(measured[through] / lengths[through]))
    start = np.array([0.0, steep, 0.3 / longest_mm, 0.02, 0.02])
    bounds = ([-1.0, 0.0, least, 0.0, 0.0], [1.0, np.inf, 100.0 / longest_mm, MOST, MOST])
    scale = np.array([0.01, steep, 0.3 / longest_mm, 0.05, 0.05])
    fit = scipy.optimize.least_squares(misfit, start, x_scale=scale, bounds=bounds)
    if 2.0 * fit.cost > MOST_LEFT * np.sum(residual[some][counted] ** 2):
        return None
    _, attenuation, bend, around, wide = fit.x.tolist()
    hardening = scatter = None
    if bend > 2.0 * least:
        longest = attenuation * float(np.log1p(bend * longest_mm)) / bend
        hardening = BeamHardening(bend / attenuation, longest, from_counts=True)
    if around + wide > LEAST_CHANGE:
        scatter = ScatteredRadiation(around, wide, HALO)
    return BeamCorrection(hardening, scatter)


# The samples are averaged over this number of path lengths before the curve is fitted.
LENGTHS = 200
# The noise of a line integral grows with the slope dp / dm of the correction. Beyond this slope, which rays through
# metal reach, the correction continues as a straight line.
STEEPEST = 5.0
# A smaller effect changes no line integral by a thousandth.
LEAST_CHANGE = 1e-3


def fit_hardening(lengths_mm: FloatArray, integrals: FloatArray, *, from_counts: bool) -> BeamHardening | None:
    """Fit background, attenuation and hardening to line integrals of known paths; None without hardening."""
    longest_mm = float(lengths_mm.max())
    places = np.minimum((lengths_mm * (LENGTHS / longest_mm)).astype(np.intp), LENGTHS - 1).ravel()
    number = np.bincount(places, minlength=LENGTHS)
    seen = number > 0
    length, mean = (np.bincount(places, of.ravel(), LENGTHS)[seen] / number[seen] for of in (lengths_mm, integrals))
    weight = np.sqrt(number[seen])

    def residual(x: FloatArray) -> FloatArray:
        return np.asarray(weight * (mean - x[0] - x[1] * (np.log1p(x[2] * length) / x[2])))

    # Unknowns: background, attenuation per mm, and spread times attenuation per mm.
    start = np.array([mean[0], (mean[-1] - mean[0]) / longest_mm, 0.3 / longest_mm])
    least = LEAST_CHANGE / longest_mm
    bounds = ([-np.inf, -np.inf, least], [np.inf, np.inf, 100.0 / longest_mm])
    _, attenuation, bend = scipy.optimize.least_squares(residual, start, x_scale=np.abs(start) + 1e-12, bounds=bounds).x
    if attenuation <= 0.0 or bend <= 2.0 * least:
        return None
    longest = attenuation * np.log1p(bend * longest_mm) / bend
    return BeamHardening(float(bend / attenuation), float(longest), from_counts)


def straightened(hardening: BeamHardening, measured: NDArray[np.float32]) -> NDArray[np.float32]:
    """Compute line integrals of the unhardened beam, (exp(v m) - 1) / v, from measured ones above the air's level."""
    spread = hardening.spread
    limit = np.log(STEEPEST) / spread
    above_limit = STEEPEST * np.maximum(measured - limit, 0.0)
    return np.asarray(np.expm1(spread * np.minimum(measured, limit)) / spread + above_limit, np.float32)


def measured_and_slope(hardening: BeamHardening, straight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return measured line integrals for unhardened ones, and the slope of the correction there."""
    spread = hardening.spread
    limit = (STEEPEST - 1.0) / spread
    slope = 1.0 + spread * np.clip(straight, 0.0, limit)
    return np.log(slope) / spread + np.maximum(straight - limit, 0.0) / STEEPEST + np.minimum(straight, 0.0), slope
