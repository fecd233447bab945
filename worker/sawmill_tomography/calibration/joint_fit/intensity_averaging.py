"""Intensity averaging: a cell of counts averages intensities over its rays, where the model averages paths."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sawmill_tomography.calibration.joint_fit.finding import AdjustedFit, EffectFinding
from sawmill_tomography.calibration.sinogram_data import SinogramData
from sawmill_tomography.geometry.geometry import FloatArray, SourceFrame
from sawmill_tomography.phantoms.phantom import Body, Phantom
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import Position
from sawmill_vocabulary import Adjustment
from sawmill_vocabulary.scan_messages import AdjustmentMessage

# Rays over which a cell's intensities are averaged.
FINE_RAYS = 8
ROUNDS = 2


def _adjust(plain: AdjustedFit) -> AdjustedFit:
    """Add the difference, from the fit itself, and repeat the fit, which edges along rays would bias."""
    if not plain.from_counts or plain.data.rays_per_cell == 1:  # a cell of one ray averages nothing
        return plain
    data, fit, added = plain.data, plain.fit, np.zeros(())
    for _ in range(ROUNDS):
        added = averaging(plain.phantom, plain.data, fit.frame, position_mm=fit.position_mm, gain=fit.gain)
        data = replace(plain.data, sinogram=plain.data.sinogram + added)
        again = plain.refitted(data, fit)
        if again is None:
            return plain
        fit = again
    return replace(plain.after(data, fit, AdjustmentMessage.INTENSITY_AVERAGING()), averaging=added)


def averaging(
    phantom: Phantom | Body,
    data: SinogramData,
    frame: SourceFrame,
    *,
    position_mm: Position,
    gain: FloatArray | float,
    turns: Sequence[tuple[float, float]] = ((0.0, 1.0),),
) -> FloatArray:
    """Compute what a cell that averages intensities over its rays measures less than of its mean paths, (views, cells).

    The paths p are in the data's unit. While a view is exposed the phantom turns by `turns`: angles, rad, and weights.
    """
    cells, of_rays, of_means, each = data.cells, 0.0, 0.0, np.full(FINE_RAYS, 1.0 / FINE_RAYS)
    for turn, weight in turns:
        rays = analytic.project(
            phantom, cells.divided(FINE_RAYS), frame, data.angles_rad + turn, position_mm=position_mm, rays_per_cell=1
        )
        np.multiply(rays, -gain, out=rays)
        by_cell = rays.reshape(len(data.sinogram), cells.count, FINE_RAYS)
        of_means = of_means + weight * np.exp(by_cell @ each)
        of_rays = of_rays + weight * (np.exp(by_cell, out=by_cell) @ each)
    return np.asarray(np.log(of_rays / of_means))


INTENSITY_AVERAGING = EffectFinding(Adjustment.INTENSITY_AVERAGING, _adjust)
