"""The one forward model: what the detector measures of a phantom, every fitted term included."""

import numpy as np
from scipy.ndimage import correlate1d

from sawmill_worker.tomography import analytic
from sawmill_worker.tomography.calibration.fit import Fit
from sawmill_worker.tomography.calibration.sinogram_data import SinogramData
from sawmill_worker.tomography.geometry import FloatArray
from sawmill_worker.tomography.phantom import Phantom


def modelled(phantom: Phantom, data: SinogramData, fit: Fit) -> FloatArray:
    """The model sinogram (views, cells) in the data's unit."""
    shape = _shape(phantom, data, fit)
    if data.view_gain:
        return _with_gain_of_each_view(shape, data)
    common: FloatArray = fit.gain * shape + fit.offset
    return common


def _shape(phantom: Phantom, data: SinogramData, fit: Fit) -> FloatArray:
    """Before gain and offset: the shadow with gradient, hardening and blur, as far as they are fitted."""
    given = (phantom, data.cells, fit.frame, data.angles_rad)
    if data.density_gradient:
        shadow, moments = analytic.project_with_moments(
            *given, position_mm=fit.position_mm, rays_per_cell=data.rays_per_cell
        )
        slope_x, slope_y = fit.gradient_per_mm
        shape = shadow + slope_x * moments[0] + slope_y * moments[1]
    else:
        shape = shadow = analytic.project(*given, position_mm=fit.position_mm, rays_per_cell=data.rays_per_cell)
    if data.hardening:
        shape = shape + fit.hardening * shadow**2
    if data.blur_cells > 0.0:
        taps = analytic.blur_taps(data.blur_cells)
        blurred: FloatArray = correlate1d(shape, np.concatenate([taps[:0:-1], taps]), axis=1, mode="reflect")
        return blurred
    bare: FloatArray = shape
    return bare


def _with_gain_of_each_view(shape: FloatArray, data: SinogramData) -> FloatArray:
    """Each view's gain and offset by weighted linear regression on the shape."""
    weights = np.ones_like(shape) if data.weights is None else data.weights
    total = np.maximum(weights.sum(axis=1, keepdims=True), 1e-300)  # a view left out has no level of its own: 0
    centre = (weights * shape).sum(axis=1, keepdims=True) / total
    level = (weights * data.sinogram).sum(axis=1, keepdims=True) / total
    power = (weights * (shape - centre) ** 2).sum(axis=1, keepdims=True)
    gains = (weights * (shape - centre) * data.sinogram).sum(axis=1, keepdims=True) / np.maximum(power, 1e-300)
    model: FloatArray = level + gains * (shape - centre)
    return model
