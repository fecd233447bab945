"""The first image of a slice, and the typical attenuation in it."""

import numpy as np

from sawmill_tomography.geometry.geometry import GeometryError
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.iterative.descent import Floats, Images


def mean_along_rays(projector: Projector, lines: Images) -> Images:
    """Compute a first image: each pixel is the mean, weighted by length, of the mean attenuation along its rays.

    (slices, views, detector) -> (slices, n, n), in attenuation; 0 where no ray passes.
    """
    ones = np.ones((projector.grid.size, projector.grid.size), np.float32)
    lengths = projector.forward(ones)
    crossed = projector.adjoint(np.ones_like(lengths))
    mean = np.divide(lines, lengths, out=np.zeros_like(lines), where=lengths > 0.0)
    image: Images = projector.adjoint(mean)
    return np.divide(image, crossed, out=np.zeros_like(image), where=crossed > 0.0)


def typical_attenuation(images: Images) -> Floats:
    """Return the mass-weighted mean attenuation of each slice, sum x^2 / sum x, (slices,), from `mean_along_rays`."""
    body = np.maximum(images, 0.0).astype(np.float64)
    mass = body.sum(axis=(1, 2))
    if not (mass > 0.0).all():
        raise GeometryError("a slice has no attenuation anywhere, so its scale cannot be chosen: leave it out")
    return np.asarray(np.square(body).sum(axis=(1, 2)) / mass)
