"""Beam hardening: fitted to a phantom's scan, and corrected in the line integrals of a log's scan.

Where the attenuation over the beam's spectrum follows a gamma distribution of mean 1 and variance v, a line integral p
is measured as m = -ln E[exp(-a p)] = ln(1 + v p) / v: the logarithm of the distribution's Laplace transform. One
number describes any spectrum well enough, extrapolates sensibly beyond the phantom's longest path, and is not
affected by small errors of a drawing, as the powers of p are.
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary.hardening import BeamHardening

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
        bent = np.log1p(x[2] * length) / x[2]
        weighted: FloatArray = weight * (mean - x[0] - x[1] * bent)
        return weighted

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
    inside = np.clip(straight, 0.0, limit)
    slope = 1.0 + spread * inside
    measured = np.log(slope) / spread + np.maximum(straight - limit, 0.0) / STEEPEST + np.minimum(straight, 0.0)
    return measured, slope
