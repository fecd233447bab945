"""Metal in the phantom, as screws, nails and brackets: rays through metal are starved, and no model of wood fits.

The residual of a fitted model shows metal as it does in a log (`reconstruction.metal_finder`). Every sample that sees
metal is then left out.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.calibration.covariance import CHANCE
from sawmill_tomography.calibration.fit import Fit, OnStep, ignore_progress, refine
from sawmill_tomography.calibration.sinogram_data import SinogramData
from sawmill_tomography.geometry.geometry import FanBeamGeometry, GeometryError
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.reconstruction.metal import (
    LEAST_NOISE,
    LEAST_WOOD_MM,
    MOST_SAMPLES,
    MetalFinder,
    Shadows,
    smoothed,
)
from sawmill_tomography.statistics import robust_deviation
from sawmill_vocabulary import Handedness, Scanner
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.scan_messages import AdjustmentMessage

Samples = NDArray[np.bool_]

# The search is repeated, since the metal biases the first fit.
ROUNDS = 3


@dataclass(frozen=True, eq=False)
class PhantomMetal:
    """Metal in a phantom."""

    samples: Samples  # (views, cells) bool: samples that see metal
    places_mm: tuple[tuple[float, float], ...]  # the middle of each piece in the image frame, x and y

    def reason(self, handedness: Handedness, position_mm: tuple[float, float]) -> Reason:
        """Return the reason that reports the metal, with places in the drawing of a phantom in this pose."""
        side = 1.0 if handedness is Handedness.AS_DRAWN else -1.0
        drawn = ((x - position_mm[0], side * (y - position_mm[1])) for x, y in self.places_mm)
        places = ", ".join(f"({x:.0f}, {y:.0f})" for x, y in drawn)
        return AdjustmentMessage.METAL(places=places, share_percent=100.0 * float(self.samples.mean()))


def find_metal(
    phantom: Phantom, data: SinogramData, fit: Fit, on_step: OnStep = ignore_progress
) -> PhantomMetal | None:
    """Find metal in a phantom, from a fit to a scan that may show metal; None where there is none."""
    result: PhantomMetal | None = None
    for _ in range(ROUNDS):
        metal = _metal(phantom, data, fit)
        if metal is None:
            break
        result = metal
        weighted = replace(data, weights=np.where(metal.samples, 0.0, 1.0 if data.weights is None else data.weights))
        again = refine(phantom, weighted, fit.frame, position_mm=fit.position_mm, on_step=on_step)
        if again is None:
            break
        fit = again
    return result


def _metal(phantom: Phantom, data: SinogramData, fit: Fit) -> PhantomMetal | None:
    """Find the metal that a fit's residual shows; None where there is none."""
    radius_mm = phantom.radius_mm + math.hypot(*fit.position_mm)
    distance_mm, cells = fit.frame.source_distance_mm, data.cells
    # A scanner whose source is that far away takes any frame: its theta has no source shift.
    scanner = Scanner(distance_mm, cells.count, cells.width_mm, (), cells.arc_radius_mm, cells.waves_mm)
    try:
        fan = FanBeamGeometry(scanner, fit.frame.theta(distance_mm), data.angles_rad)
    except GeometryError:  # no scanner has a frame to which this fit diverged: it shows no metal
        return None
    finder = MetalFinder.of(fan, radius_mm)
    if finder is None:
        return None
    residual = _residual(phantom, data.every(finder.step), fit)
    wood_per_mm = fit.gain * max(shape.density for shape in phantom.shapes)
    least = max(LEAST_WOOD_MM * wood_per_mm, LEAST_NOISE * robust_deviation(residual) / math.sqrt(3.0))
    shadows = Shadows(np.maximum(smoothed(residual), 0.0), least, wood_per_mm)
    body = finder.bodies([shadows])[0]
    if not body.any():
        return None
    residual = _residual(phantom, data, fit)
    samples: Samples = finder.traced(replace(shadows, excess=np.maximum(smoothed(residual), 0.0)), body)
    while True:  # neighbours that metal blurs into
        wider = scipy.ndimage.maximum_filter1d(samples, 3, axis=1)
        edge = residual[wider & ~samples]
        if edge.size == 0 or edge.mean() < CHANCE * edge.std() / math.sqrt(edge.size):
            break
        samples = wider
    if samples.mean() > MOST_SAMPLES:
        return None
    pieces, count = scipy.ndimage.label(body, np.ones((3, 3)))
    middles = np.array(scipy.ndimage.center_of_mass(body, pieces, np.arange(1, count + 1)))
    grid = finder.fine.grid
    places = np.array(grid.low_mm) + (middles + 0.5) * grid.pixel_mm
    return PhantomMetal(samples, tuple((x, y) for x, y in places.tolist()))


def _residual(phantom: Phantom, data: SinogramData, fit: Fit) -> NDArray[np.float32]:
    """Compute the residual without each cell's median over the views; 0 where samples have no weight."""
    residual = (data.sinogram - fit.prediction(phantom, data)).astype(np.float32)
    residual -= np.median(residual, axis=0)
    if data.weights is not None:
        residual[data.weights == 0.0] = 0.0
    return residual
