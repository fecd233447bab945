"""The focal spot and the scintillator blur along the detector: a Gaussian, its width found by least squares."""

from dataclasses import replace

import numpy as np
from scipy.fft import dct
from scipy.optimize import minimize_scalar

from sawmill_worker.tomography.calibration.faults.finding import AdjustedFit, Finding
from sawmill_worker.tomography.calibration.faults.linear_terms import LEAST_CHI_SQUARE, LEAST_SHARE
from sawmill_worker.tomography.calibration.forward_model import modelled
from sawmill_worker.tomography.geometry import FloatArray
from sawmill_worker.vocabulary import Adjustment

# In cells, the Gaussian's standard deviation: less is lost in the averaging over the cell itself, more is no blur.
LEAST_BLUR, MOST_BLUR = 0.2, 8.0
# The first width was found beside a sharp fit.
ROUNDS = 2


def _adjust(now: AdjustedFit) -> AdjustedFit:
    data, fit = now.data, now.fit
    for number in range(ROUNDS):
        model = modelled(now.phantom, replace(data, blur_cells=0.0), fit)
        residual = data.sinogram - model
        if data.weights is not None:
            residual *= data.weights > 0.0
        width, share = _width(model, residual)
        if number == 0 and (share * data.samples < LEAST_CHI_SQUARE or share < LEAST_SHARE or width < LEAST_BLUR):
            return now
        data = replace(data, blur_cells=width)
        again = now.refitted(data, fit)
        if again is None or again.residual_rms >= now.fit.residual_rms:
            return now
        fit = again
    return now.after(data, fit, f"a blur of {data.blur_cells:.2f} detector cells (standard deviation) was fitted")


def _width(model: FloatArray, residual: FloatArray) -> tuple[float, float]:
    """The width in cells that explains most of a sharp model's residual (views, cells), and which share of its power.

    A cosine transform continues each view evenly beyond the detector's ends; there a blur is a factor.
    """
    sharp, remaining = dct(model, axis=1, norm="ortho"), dct(residual, axis=1, norm="ortho")
    power, cross, total = (sharp**2).sum(axis=0), (sharp * remaining).sum(axis=0), float((remaining**2).sum())
    frequency = np.pi * np.arange(power.size) / power.size

    def misfit(width: float) -> float:
        change = np.expm1(width**2 * (np.cos(frequency) - 1.0))
        return float((change * change * power - 2.0 * change * cross).sum())

    found = minimize_scalar(misfit, bounds=(0.0, MOST_BLUR), method="bounded", options={"xatol": 1e-3})
    return float(found.x), -float(found.fun) / total if total > 0.0 else 0.0


BLUR = Finding(Adjustment.BLUR, _adjust)
