"""The table of reconstruction methods, and the choice of the method for the data: method="auto"."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from sawmill_tomography.geometry.geometry import TAU, FanViews, FloatArray, turns_all_round
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.reconstruction import cost
from sawmill_tomography.reconstruction.cauchy_map import CauchyMap
from sawmill_tomography.reconstruction.fbp import FilteredBackProjection
from sawmill_tomography.reconstruction.method import FittedMethod, Method
from sawmill_tomography.reconstruction.tikhonov import Tikhonov
from sawmill_tomography.reconstruction.total_variation import RingTotalVariation, TotalVariation
from sawmill_tomography.sinograms.noise import estimated_noise
from sawmill_vocabulary import Preference, ReconstructionMethod

# Price of `quality` on two cores: seconds for a slice of this size; more pixels may cost more.
PRICE_SECONDS, PRICE_SIZE = 0.1, 256
# From this number of views on `speed` takes filtered back-projection.
SPEED_VIEWS = 90
# Views are left out of a scan down to this number.
LEAST_VIEWS = 20
# Relative errors with the parameters that each method chooses: the geometric mean over six simulated logs with the
# rings of real wood, by views and by noise as a share of the signal (benchmarks/expected_error.py). Beyond the views
# that were measured an error is assumed to stay constant. The Cauchy MAP is beyond the price from 20 views on. Of equal
# errors the first counts: ring-aware variation, which falls back on total variation where no rings are predicted.
VIEWS = (12, 20, 45, 90, 180, 360)
NOISES = (0.005, 0.02, 0.08)
EXPECTED_ERRORS: Mapping[ReconstructionMethod, tuple[tuple[float, ...], ...]] = MappingProxyType(
    {
        ReconstructionMethod.FBP: (
            (0.5456, 0.6247, 1.3371),
            (0.4524, 0.5068, 1.0414),
            (0.2321, 0.2789, 0.6692),
            (0.1478, 0.1833, 0.4669),
            (0.0960, 0.1225, 0.3274),
            (0.0707, 0.0887, 0.2318),
        ),
        ReconstructionMethod.TIKHONOV: ((0.2359, 0.2478, 0.3119), (0.2198, 0.2315, 0.2833), (0.1472, 0.1650, 0.2402)),
        ReconstructionMethod.RING_TV: (
            (0.1206, 0.1247, 0.1489),
            (0.1035, 0.1069, 0.1373),
            (0.0768, 0.0884, 0.1200),
            (0.0594, 0.0777, 0.1102),
        ),
        ReconstructionMethod.TOTAL_VARIATION: (
            (0.1271, 0.1283, 0.1514),
            (0.1153, 0.1162, 0.1393),
            (0.0927, 0.0989, 0.1218),
        ),
    }
)
# The logs of the table were measured with pixels and cells (at the rotation centre) of this size.
MEASURED_PIXEL_MM, MEASURED_CELL_MM = 1.5625, 0.851


@dataclass(frozen=True)
class Recommendation:
    """A recommended method and, in one sentence, why."""

    method: ReconstructionMethod
    view_step: int  # every view_step-th of the views, in the order of their angles, fits into the price
    expected_error: float | None  # relative error of simulated logs; None where the views do not cover a full turn
    reason: str


@dataclass(frozen=True)
class _Candidate:
    """A method with every step-th view: its expected error, and its seconds a slice."""

    method: ReconstructionMethod
    step: int
    views: int
    error: float
    seconds: float


def expected_error(method: ReconstructionMethod, views: int, noise: float) -> float:
    """Return a method's relative error by `EXPECTED_ERRORS`, interpolated in logarithms up to the table's border."""
    rows = np.log(EXPECTED_ERRORS[method])
    by_views = [np.interp(np.log(noise), np.log(NOISES), row) for row in rows]
    return float(np.exp(np.interp(np.log(views), np.log(VIEWS[: len(rows)]), by_views)))


def comparable_noise(geometry: FanViews, grid: ImageGrid, share: float, *, fitted: bool) -> float:
    """Convert a share of noise to the pixels and cells of the table.

    A ray's noise counts relative to the attenuation of one pixel, and is averaged over the cells that a pixel covers.
    But a fitted method smooths pixels smaller than the table's to what the data show: pixels of half the size have the
    same error (benchmarks/expected_error.py --check, the CT slice).
    """
    pixel = max(grid.pixel_mm / MEASURED_PIXEL_MM, 1.0 if fitted else 0.0)
    return share / pixel * float(np.sqrt(geometry.cell_at_cor_mm / MEASURED_CELL_MM / pixel))


def seconds_a_slice(method: ReconstructionMethod, views: int, cells: int, size: int) -> float:
    """Return the seconds on two cores for each slice of a long log, by the model of `cost`.

    A method that fits the data has a grid of this size that holds the log, and its parameters already chosen.
    """
    kind = METHODS[method]
    if issubclass(kind, FittedMethod):
        a_pair = cost.SECONDS_A_CROSSING * views * cells * size + cost.SECONDS_A_STEP_PIXEL * size * size
        return kind.pairs_a_slice * a_pair
    return cost.seconds_a_slice(views, cells, size)


def recommend(
    geometry: FanViews,
    sinogram: ArrayLike,
    grid: ImageGrid,
    *,
    fitted_size: int,
    prefer: Preference = Preference.QUALITY,
) -> Recommendation:
    """Recommend a method for a sinogram (views, detector), by its views, its noise and the price in time.

    Parameters
    ----------
    grid : ImageGrid
        Grid of the slices.
    fitted_size : int
        Side of a square with the number of pixels that fitted methods need to hold all of the log.
    """
    data = np.ascontiguousarray(sinogram, np.float32)
    share = estimated_noise(data) / max(float(np.sqrt(np.mean(np.square(data, dtype=np.float64)))), 1e-30)
    candidates = list(_candidates(geometry, share, grid, fitted_size))
    direct = next((one for one in candidates if one.method is ReconstructionMethod.FBP), None)
    if prefer is Preference.SPEED and direct is not None and direct.views >= SPEED_VIEWS:
        return Recommendation(direct.method, 1, direct.error, f"speed was preferred: {_words(direct, geometry)}")
    # A small region of a large log may cost as much as the whole log: its rays cross all of the log.
    price = PRICE_SECONDS * (max(grid.size, fitted_size) / PRICE_SIZE) ** 2
    affordable = [one for one in candidates if one.seconds <= price]
    if not affordable:
        cheapest = min(candidates, key=lambda one: one.seconds)
        reason = f"nothing costs less than {_milliseconds(price)} a slice; the least: {_words(cheapest, geometry)}"
        return Recommendation(cheapest.method, cheapest.step, cheapest.error, reason)
    best = min(affordable, key=lambda one: one.error)
    if direct is None:
        reason = (
            f"the views are no full turn about one axis, which filtered back-projection needs: {_words(best, geometry)}"
        )
        return Recommendation(best.method, best.step, None, reason)
    reason = f"the lowest expected error within {_milliseconds(price)} a slice with {100.0 * share:.2g} % noise: "
    alternative = "" if best is direct else f"; {_words(direct, geometry)}"
    return Recommendation(best.method, best.step, best.error, reason + _words(best, geometry) + alternative)


def views_of_step(angles_rad: FloatArray, step: int) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Return the indices of every step-th view in the order of the angles, in the order of the scan."""
    return np.sort(np.argsort(np.mod(angles_rad, TAU), kind="stable")[::step])


def _candidates(geometry: FanViews, share: float, grid: ImageGrid, fitted_size: int) -> Iterator[_Candidate]:
    views, cells = geometry.sinogram_shape
    for method in EXPECTED_ERRORS:
        fitted = issubclass(METHODS[method], FittedMethod)
        if not (fitted or turns_all_round(geometry)):
            continue
        pixels = fitted_size if fitted else grid.size
        noise = comparable_noise(geometry, grid, share, fitted=fitted)
        for step in range(1, max(views // LEAST_VIEWS, 1) + 1) if fitted else (1,):
            used = -(-views // step)
            seconds = seconds_a_slice(method, used, cells, pixels)
            yield _Candidate(method, step, used, expected_error(method, used, noise), seconds)


def _words(one: _Candidate, geometry: FanViews) -> str:
    name = one.method.value
    of = f"{one.views} views" if one.step == 1 else f"{one.views} of the {geometry.angles_rad.size} views"
    if not turns_all_round(geometry):
        return f"{name} from {of}, {_milliseconds(one.seconds)}"
    return f"{name} from {of}, relative error {one.error:.2g}, {_milliseconds(one.seconds)}"


def _milliseconds(seconds: float) -> str:
    return f"{float(f'{1e3 * seconds:.2g}'):g} ms"


METHODS: Mapping[ReconstructionMethod, type[Method]] = MappingProxyType(
    {
        ReconstructionMethod.FBP: FilteredBackProjection,
        ReconstructionMethod.TIKHONOV: Tikhonov,
        ReconstructionMethod.CAUCHY_MAP: CauchyMap,
        ReconstructionMethod.TOTAL_VARIATION: TotalVariation,
        ReconstructionMethod.RING_TV: RingTotalVariation,
    }
)
