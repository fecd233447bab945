"""Structure in the residual beyond white noise: the amount, and the place."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.calibration.covariance import CHANCE
from sawmill_tomography.calibration.sinogram_data import FEW_VIEWS
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.statistics import few_with_most, robust_deviation

# Cells are wrong in all views when what all views leave in the same cells exceeds this share of the sinogram. A scan of
# cells in their order leaves at most 0.012 (benchmarks/families.py, benchmarks/measured.py).
STANDING = 0.05
# Views are to blame when the share FEW_VIEWS of them has most of the residual's power, over the whole view: a view's
# mean square root of the residual, which a few strong cells do not dominate, is squared and must exceed the median
# view's by the factor ALL_OVER.
ALL_OVER = 2.0
# A kink of the shadow has a second difference above this share of the shadow's depth.
KINK = 0.005
# Edges are to blame when a cell at an edge has this multiple of the power of a cell elsewhere in the shadow.
EDGES_STAND_OUT = 3.0
# Another body shades the air when more than this share of the samples next to the shadow is darker than by chance.
SHADED = 0.02
# The least depth of the shadow proper, as a share of the largest.
SHADOW = 0.02


class ResidualPlace(StrEnum):
    """A place where model and scan differ."""

    STANDING = "same cells in all views"
    VIEWS = "few views"
    CELLS = "single cells"
    EDGES = "edges"
    SHADOW = "shadow"
    BESIDE = "beside the shadow"


@dataclass(frozen=True)
class Structure:
    """Structure in a residual beyond noise."""

    share: float  # RMS of the structure against the RMS of the sinogram without its mean
    place: ResidualPlace  # place of most of the structure; `STANDING` where all views share much of it
    cells: Mapping[str, int] = field(default_factory=dict)


def find_structure(residual: FloatArray, model: FloatArray) -> Structure:
    """Find the structure in a residual (views, cells) of this model sinogram; unusable samples must be 0."""
    shared, spread = shared_power(residual), float(model.std())
    share = math.sqrt(shared) / spread if spread > 0.0 else 0.0
    views, means = len(residual), residual.mean(axis=0)
    # The mean product of two different views, which noise does not have.
    standing = (views * float((means**2).mean()) - float((residual**2).mean())) / (views - 1)
    if standing > (STANDING * spread) ** 2:
        wrong = np.flatnonzero(means**2 > (means**2).mean())
        return Structure(share, ResidualPlace.STANDING, {"first_cell": int(wrong[0]), "last_cell": int(wrong[-1])})
    return Structure(share, _place(residual, model, shared))


def shared_power(residual: FloatArray) -> float:
    """Compute the mean square of a residual (views, cells) beyond noise, which may vary in size from place to place.

    Neighbouring samples do not share noise, but share errors of the model.
    """
    return max(
        mean_beyond_chance(residual[:, 1:] * residual[:, :-1]), mean_beyond_chance(residual[1:] * residual[:-1]), 0.0
    )


def mean_beyond_chance(products: FloatArray) -> float:
    """Compute the mean of products; 0 where independent noise, of any unevenness, has a mean as large."""
    mean, square = float(products.mean()), float(np.vdot(products, products)) / products.size
    return beyond_chance(mean, math.sqrt(max(square - mean * mean, 0.0)), products.size)


def beyond_chance(mean: float, deviation: float, count: int) -> float:
    """Return the mean of products of this standard deviation; 0 where independent noise has a mean as large."""
    return mean if mean > CHANCE * deviation / math.sqrt(count) else 0.0


def _place(residual: FloatArray, model: FloatArray, shared: float) -> ResidualPlace:
    power = residual**2
    # Power that all views have in a cell and not in the next cell; the mean over the views leaves some of the noise.
    cells = residual.mean(axis=0)
    unequal = 0.5 * float((np.diff(cells) ** 2).mean()) - (float(power.mean()) - shared) / len(residual)
    if 2.0 * unequal > shared:
        return ResidualPlace.CELLS
    if (worst := few_with_most(power.sum(axis=1), FEW_VIEWS)).size:
        level = np.sqrt(np.abs(residual)).mean(axis=1) ** 2
        if np.median(level[worst]) > ALL_OVER * np.median(level):
            return ResidualPlace.VIEWS
    depth = float(np.ptp(model))
    bent = -2.0 * model
    bent[:, 1:] += model[:, :-1]
    bent[:, :-1] += model[:, 1:]
    at_edges = np.abs(bent) > KINK * depth
    if _shades_air(residual, (model <= model.min() + SHADOW * depth) & ~at_edges):
        return ResidualPlace.BESIDE
    in_shadow = (model > model.min() + SHADOW * depth) & ~at_edges
    edges, elsewhere = (float(power[some].sum()) / max(int(some.sum()), 1) for some in (at_edges, in_shadow))
    return ResidualPlace.EDGES if edges > EDGES_STAND_OUT * elsewhere else ResidualPlace.SHADOW


def _shades_air(residual: FloatArray, air: NDArray[np.bool_]) -> bool:
    """Return whether a body shades samples (views, cells) that should show air."""
    beside = residual[air]
    if beside.size == 0:
        return False
    strong = CHANCE * robust_deviation(beside)
    darker, brighter = float((beside > strong).mean()), float((beside < -strong).mean())
    return strong > 0.0 and darker - brighter > SHADED
