"""Slices coupled along the axis: one objective for a block of neighbouring slices.

Each slice has its own objective; in addition, differences between neighbouring slices are penalised like the
differences in the plane (anisotropic: the length of the gradient in the plane, and the magnitude along the axis).
"""

from dataclasses import dataclass

import numpy as np

from sawmill_tomography.reconstruction.iterative import _prior_numba as kernels
from sawmill_tomography.reconstruction.iterative.descent import Floats, Images, Indices, Minimum, OnIteration, minimise
from sawmill_tomography.reconstruction.iterative.penalised import InverseCurvature, Objective


@dataclass(frozen=True, eq=False)
class CoupledObjective:
    """The sum of the slices' objectives, and of the penalty between neighbours."""

    slices: Objective  # objective of neighbouring slices, in their order, by total variation
    coupling: Floats  # (slices - 1,)

    def __call__(self, volumes: Images, _which: Indices) -> tuple[Floats, Images]:
        """Return value (1,) and gradient (1, slices, n, n) of one block (1, slices, n, n)."""
        images = volumes[0]
        values, gradient = self.slices(images, np.arange(len(images)))
        axial = np.empty((len(images) - 1, images.shape[1]))
        kernels.axial(images, *self.axial, gradient, axial)
        return np.array([values.sum() + axial.sum()]), gradient[None]

    @property
    def axial(self) -> tuple[Floats, Floats]:
        """Scales and strengths between neighbours."""
        prior = self.slices.prior
        scale = np.sqrt(prior.scale[1:] * prior.scale[:-1])
        return scale, self.coupling * np.sqrt(prior.strength[1:] * prior.strength[:-1])


class _CoupledCurvature:
    """The preconditioner of each slice, stiffer by the differences along the axis."""

    def __init__(self, objective: CoupledObjective, own: InverseCurvature) -> None:
        self._objective, self._own = objective, own

    def scaling(self, volumes: Images, _which: Indices) -> Images:
        images = volumes[0]
        soft = self._own.scaling(images, np.arange(len(images)))
        kernels.stiffen(images, *self._objective.axial, self._own.flat(), soft)
        return soft[None]

    def smoothed(self, volumes: Images, _which: Indices) -> Images:
        return self._own.smoothed(volumes[0], np.arange(volumes.shape[1]))[None]


def descend_coupled(
    objective: CoupledObjective,
    start: Images,
    *,
    non_negative: bool,
    iterations: int,
    tolerance: float,
    window: int,
    curvature: InverseCurvature,
    first_scale: float = 1.0,
    on_iteration: OnIteration | None = None,
) -> Minimum:
    """Minimise for a block (slices, n, n) together; each slice has the block's value, iterations and end.

    The curvature belongs to the slices without coupling.
    """
    minimum = minimise(
        objective,
        start[None],
        lower=0.0 if non_negative else -np.inf,
        iterations=iterations,
        tolerance=tolerance,
        window=window,
        preconditioner=_CoupledCurvature(objective, curvature),
        first_scale=first_scale,
        on_iteration=on_iteration,
    )
    slices = len(start)
    return Minimum(
        images=minimum.images[0],
        values=np.repeat(minimum.values, slices),
        iterations=np.repeat(minimum.iterations, slices),
        converged=np.repeat(minimum.converged, slices),
    )
