"""What the residual holds beside white noise: how much, and where it lies."""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FloatArray

# Views are to blame when this small share of them holds this share of the residual's power, and over the whole view:
# their mean square root of it, which a few strong cells do not dominate, exceeds the other views' by this factor.
FEW_VIEWS, MOST_POWER, ALL_OVER = 0.05, 0.5, 2.0
# A kink of the shadow stands out by this share of its depth, from cell to cell; so do the cells beside it, this number.
KINK, BESIDE = 0.005, 2
# Edges are to blame when a cell there holds this multiple of the power of one elsewhere in the shadow.
EDGES_STAND_OUT = 3.0
# A mean of products is noise up to this number of its standard deviations.
CHANCE = 4.0
# The shadow proper, as a share of its depth.
SHADOW = 0.02


class ResidualPlace(StrEnum):
    """Where the model is not the scan's."""

    VIEWS = "few views"
    CELLS = "single cells"
    EDGES = "edges"
    SHADOW = "shadow"


@dataclass(frozen=True)
class Structure:
    """What a residual holds beside noise.

    Attributes
    ----------
    share : float
        Its RMS against that of the sinogram without its mean.
    place : ResidualPlace
        Where most of it lies.
    """

    share: float
    place: ResidualPlace


def find_structure(residual: FloatArray, model: FloatArray) -> Structure:
    """Of a residual (views, cells) of this model sinogram; 0 where nothing may be used."""
    shared = shared_power(residual)
    spread = float(model.std())
    return Structure(math.sqrt(shared) / spread if spread > 0.0 else 0.0, _place(residual, model, shared))


def shared_power(residual: FloatArray) -> float:
    """Mean square of what a residual (views, cells) holds beside noise, whatever the noise's size here and there.

    Noise is not shared by neighbours; what a model lacks is.
    """
    return max(
        mean_beyond_chance(residual[:, 1:] * residual[:, :-1]), mean_beyond_chance(residual[1:] * residual[:-1]), 0.0
    )


def mean_beyond_chance(products: FloatArray) -> float:
    """Their mean, or nothing where independent noise, as uneven as it may be, has one as large."""
    mean, square = float(products.mean()), float(np.einsum("km,km->", products, products)) / products.size
    return beyond_chance(mean, math.sqrt(max(square - mean * mean, 0.0)), products.size)


def beyond_chance(mean: float, deviation: float, count: int) -> float:
    """The mean of products of this standard deviation, or nothing where independent noise has one as large."""
    return mean if mean > CHANCE * deviation / math.sqrt(count) else 0.0


def _place(residual: FloatArray, model: FloatArray, shared: float) -> ResidualPlace:
    power = residual**2
    # What every view sees in a cell, and its neighbour does not; the views' mean leaves some of the noise.
    cells = residual.mean(axis=0)
    unequal = 0.5 * float((np.diff(cells) ** 2).mean()) - (float(power.mean()) - shared) / len(residual)
    if unequal > MOST_POWER * shared:
        return ResidualPlace.CELLS
    by_view = power.sum(axis=1)
    worst = np.argsort(by_view)[-max(1, round(FEW_VIEWS * len(by_view))) :]
    if by_view[worst].sum() > MOST_POWER * by_view.sum():
        level = np.sqrt(np.abs(residual)).mean(axis=1) ** 2
        if np.median(level[worst]) > ALL_OVER * np.median(level):
            return ResidualPlace.VIEWS
    depth = float(np.ptp(model))
    bent = -2.0 * model
    bent[:, 1:] += model[:, :-1]
    bent[:, :-1] += model[:, 1:]
    kinks = np.abs(bent) > KINK * depth
    at_edges = kinks.copy()
    for away in range(1, BESIDE + 1):
        at_edges[:, away:] |= kinks[:, :-away]
        at_edges[:, :-away] |= kinks[:, away:]
    in_shadow = (model > model.min() + SHADOW * depth) & ~at_edges
    return (
        ResidualPlace.EDGES
        if _mean(power, at_edges) > EDGES_STAND_OUT * _mean(power, in_shadow)
        else ResidualPlace.SHADOW
    )


def _mean(power: FloatArray, where: NDArray[np.bool_]) -> float:
    return float(np.einsum("km,km->", power, where)) / max(int(where.sum()), 1)
