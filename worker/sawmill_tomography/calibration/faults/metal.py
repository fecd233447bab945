"""Metal in the phantom, as screws, nails and brackets: rays through metal are starved, and no model of wood fits.

The residual of a fitted model is back-projected. There is metal where the rays of all views are weaker than behind
wood, by many times what wood of that size absorbs. Every sample that sees metal is then left out.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.calibration.fit import Fit, OnStep, ignore_progress, refine
from sawmill_tomography.calibration.sinogram_data import SinogramData
from sawmill_tomography.geometry.geometry import FloatArray, rotate
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection import analytic
from sawmill_tomography.statistics import robust_deviation
from sawmill_vocabulary import Handedness
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.scan_messages import AdjustmentMessage

Samples = NDArray[np.bool_]

# Fewer views do not show a body by its shadows.
FEWEST_VIEWS = 8
# The whole phantom is searched in steps of COARSE_MM, in about COARSE_VIEWS views, smoothed over SMOOTHED_MM.
COARSE_MM, COARSE_VIEWS, SMOOTHED_MM = 4.0, 40, 5.0
# A sample counts for at most this share of the phantom's depth: another piece of metal may lie on the ray.
CLIPPED = 0.25
# Places that exceed the median by STANDS_OUT robust standard deviations, at most MOST_PLACES, are searched again in
# steps of 1 mm, up to AROUND_MM from each place.
STANDS_OUT, MOST_PLACES, AROUND_MM = 6.0, 24, 14
# A median over the views is beyond chance when it exceeds this number of standard deviations of the median.
CHANCE = 6.0
# Metal absorbs as much as LEAST_WOOD_MM of wood, and is denser than wood by more than the factor DENSER, in an image of
# resolution FINEST_MM: steel is 15 to 40 times as dense, a knot up to 2 (benchmarks/metal.py).
LEAST_WOOD_MM, DENSER, FINEST_MM = 8.0, 2.5, 3.0
# A point belongs to a piece of metal when its density is above this share of the piece's highest density.
BODY = 0.3
# Cells left out next to the metal's shadow: MARGIN on each side, and up to MOST_MARGIN more while the mean residual in
# the next cells is above MARGIN_DEVIATIONS standard deviations of the mean.
MARGIN, MOST_MARGIN, MARGIN_DEVIATIONS = 1, 8, 3.0
# Largest radius of the searched disc, whose points are 1 mm apart. No saw takes so large a log, so the position of a
# phantom farther out is wrong (tests/calibration/test_absurd_values.py).
LARGEST_RADIUS_MM = 2000.0
# A body that covers a larger share of the samples is not metal in a phantom.
MOST_SAMPLES = 0.25
# The search is repeated, since the metal biases the first fit; it ends when fewer than the share SETTLED of the samples
# change.
ROUNDS, SETTLED = 3, 0.02


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
        metal = _Search(phantom, data, fit).metal()
        if metal is None:
            break
        settled = result is not None and (result.samples ^ metal.samples).sum() < SETTLED * metal.samples.sum()
        result = metal
        if settled:
            break
        weights = np.where(metal.samples, 0.0, 1.0 if data.weights is None else data.weights)
        weighted = replace(data, weights=weights)
        again = refine(phantom, weighted, fit.frame, position_mm=fit.position_mm, on_step=on_step)
        if again is None:
            break
        fit = again
    return result


class _Search:
    """A search for metal by back-projection of a fit's residual."""

    def __init__(self, phantom: Phantom, data: SinogramData, fit: Fit) -> None:
        self._phantom, self._data, self._fit = phantom, data, fit
        # Attenuation of wood, per mm.
        self._wood = fit.gain * max(shape.density for shape in phantom.shapes)
        self._radius_mm = math.ceil(phantom.radius_mm + math.hypot(*fit.position_mm))

    def metal(self) -> PhantomMetal | None:
        """Find the metal that this fit's residual shows; None where there is none."""
        if len(self._data.sinogram) < FEWEST_VIEWS or self._radius_mm > LARGEST_RADIUS_MM:
            return None
        suspects = self._suspects()
        if not len(suspects):
            return None
        residual = self._residual(slice(None))
        size = 2 * self._radius_mm + 1
        body = np.zeros((size, size), bool)
        filtered = self._filtered(residual)
        for suspect in suspects:
            points = self._piece(residual, filtered, suspect)
            body[tuple((points + self._radius_mm).T)] = True
        if not body.any():
            return None
        samples = self._samples(residual, np.argwhere(body) - self._radius_mm)
        if samples.mean() > MOST_SAMPLES:
            return None
        pieces, count = scipy.ndimage.label(scipy.ndimage.maximum_filter(body, 3))
        middles = (np.argwhere(body & (pieces == one)).mean(axis=0) - self._radius_mm for one in range(1, count + 1))
        return PhantomMetal(samples, tuple((float(x), float(y)) for x, y in middles))

    def _residual(self, views: slice) -> NDArray[np.float32]:
        """Compute the residual without each cell's median over the views; 0 where samples have no weight."""
        data, fit = self._data, self._fit
        shadow = analytic.project(
            self._phantom,
            data.cells,
            fit.frame,
            data.angles_rad[views],
            position_mm=fit.position_mm,
            rays_per_cell=data.rays_per_cell,
        )
        residual = (data.sinogram[views] - fit.gain * shadow - fit.offset).astype(np.float32)
        residual -= np.median(residual, axis=0)
        if data.weights is not None:
            residual[data.weights[views] == 0.0] = 0.0
        return residual

    def _suspects(self) -> NDArray[np.intp]:
        """Find points (points, 2) mm of the image frame where the views' residuals add up."""
        views = slice(None, None, max(1, len(self._data.sinogram) // COARSE_VIEWS))
        frame, cells = self._fit.frame, self._data.cells
        residual = self._residual(views)
        width = round(SMOOTHED_MM * frame.magnification / cells.width_mm)
        smooth = _running_mean(residual, min(max(1, width), cells.count))
        clipped = CLIPPED * self._wood * 2.0 * self._phantom.radius_mm
        steps = math.ceil(self._radius_mm / COARSE_MM)
        axis = np.arange(-steps, steps + 1) * COARSE_MM
        x, y = np.meshgrid(axis, axis, indexing="ij")
        inside = np.hypot(x, y) <= self._radius_mm
        # A ray that misses the detector counts as zero.
        seen = np.pad(np.clip(smooth, -clipped, clipped), ((0, 0), (1, 1)))
        columns = self._columns(np.stack([x[inside], y[inside]], -1), views)
        at = np.clip(columns + 1.0, 0.0, cells.count + 1.0).astype(np.intp)
        at += np.arange(len(seen))[:, None] * seen.shape[1]
        image = seen.take(at).mean(axis=0, dtype=np.float64)
        image -= np.median(image)
        least = max(STANDS_OUT * robust_deviation(image), 0.25 * LEAST_WOOD_MM * self._wood)
        if image.max() <= least:
            return np.zeros((0, 2), np.intp)
        square = np.full(inside.shape, -np.inf)
        square[inside] = image
        peaks = np.argwhere((square > least) & (square == scipy.ndimage.maximum_filter(square, 3)))
        highest = np.argsort(square[tuple(peaks.T)])[::-1][:MOST_PLACES]
        suspects: NDArray[np.intp] = np.rint(axis[peaks[highest]]).astype(np.intp)
        return suspects

    def _piece(
        self, residual: NDArray[np.float32], filtered: FloatArray, suspect: NDArray[np.intp]
    ) -> NDArray[np.intp]:
        """Find the points (points, 2) mm of the metal around a suspect; none where the suspect is not metal."""
        reach = np.arange(-AROUND_MM, AROUND_MM + 1)
        points = np.stack(np.meshgrid(*(suspect[:, None] + reach), indexing="ij"), -1).reshape(-1, 2)
        points = points[np.hypot(*points.T) <= self._radius_mm]
        cells = self._cells(points)
        density = np.take_along_axis(filtered, cells, axis=1).mean(axis=0)
        at = int(density.argmax())
        seen = residual[np.arange(len(residual)), cells[:, at]]
        taken = float(np.median(seen))
        noise = 1.25 * robust_deviation(seen - taken) / math.sqrt(len(seen))
        if density[at] < DENSER * self._wood or taken < max(LEAST_WOOD_MM * self._wood, CHANCE * noise):
            return np.zeros((0, 2), np.intp)
        square = np.zeros((reach.size, reach.size))
        place = tuple((points - suspect + AROUND_MM).T)
        square[place] = density
        pieces = scipy.ndimage.label(square > BODY * density[at])[0][place]
        piece: NDArray[np.intp] = points[pieces == pieces[at]]
        return piece

    def _filtered(self, residual: NDArray[np.float32]) -> FloatArray:
        """Filter the residual (views, cells) with the ramp of parallel rays, 1/mm: the views' mean is a density.

        The filter is Kak and Slaney ch. 3, equation 61, with a Hann window, at the scale of the centre of rotation.
        """
        step_mm = self._data.cells.width_mm / self._fit.frame.magnification
        size = scipy.fft.next_fast_len(2 * residual.shape[1], real=True)
        per_mm = scipy.fft.rfftfreq(size, step_mm)
        window = np.where(per_mm < 1.0 / FINEST_MM, 0.5 + 0.5 * np.cos(math.pi * FINEST_MM * per_mm), 0.0)
        depth = 2.0 * self._phantom.radius_mm * self._wood
        spectrum = scipy.fft.rfft(np.clip(residual, -depth, depth), size, axis=1) * (math.pi * per_mm * window)
        filtered: FloatArray = scipy.fft.irfft(spectrum, size, axis=1)[:, : residual.shape[1]]
        return filtered

    def _columns(self, points_mm: NDArray[np.number], views: slice = slice(None)) -> FloatArray:
        """Compute where each view sees these points, (views, points), in cells from the detector's border."""
        frame, cells = self._fit.frame, self._data.cells
        turns = self._data.angles_rad[views] + frame.psi_rad
        x, y = rotate(-turns[:, None], *points_mm.T)
        depth = (y + frame.source_distance_mm) * math.cos(frame.tilt_rad) - x * math.sin(frame.tilt_rad)
        u = frame.cor_column_mm + frame.source_to_detector_mm * x / depth
        columns: FloatArray = (u - cells.first_border_mm) / cells.width_mm
        return columns

    def _cells(self, points_mm: NDArray[np.intp]) -> NDArray[np.intp]:
        """Find the cell in which each view sees each point (views, points); off the detector the nearest cell."""
        cells = np.floor(self._columns(points_mm)).astype(np.intp)
        on_detector: NDArray[np.intp] = np.clip(cells, 0, self._data.cells.count - 1)
        return on_detector

    def _samples(self, residual: NDArray[np.float32], points_mm: NDArray[np.intp]) -> Samples:
        """Find the samples that see a body of these points, 1 mm wide each, and neighbours that the body blurs into."""
        views, cells = residual.shape
        half = 0.7 * self._fit.frame.magnification / self._data.cells.width_mm + MARGIN
        columns = self._columns(points_mm)
        change = np.zeros((views, cells + 1), np.int32)
        view = np.broadcast_to(np.arange(views)[:, None], columns.shape)
        np.add.at(change, (view, np.clip(np.floor(columns - half), 0, cells).astype(np.intp)), 1)
        np.add.at(change, (view, np.clip(np.ceil(columns + half), 0, cells).astype(np.intp)), -1)
        samples: Samples = change[:, :-1].cumsum(axis=1) > 0
        for _ in range(MOST_MARGIN):
            wider = scipy.ndimage.maximum_filter1d(samples, 3, axis=1)
            edge = residual[wider & ~samples]
            if edge.size == 0 or edge.mean() < MARGIN_DEVIATIONS * edge.std() / math.sqrt(edge.size):
                break
            samples = wider
        return samples


def _running_mean(values: NDArray[np.float32], width: int) -> NDArray[np.float32]:
    """Average `width` cells around each, mirrored at the ends; `scipy.ndimage` for this would delay each start."""
    before = width // 2
    padded = np.pad(values, ((0, 0), (before + 1, width - 1 - before)), mode="symmetric")
    sums = padded.cumsum(axis=1, dtype=np.float64)
    mean: NDArray[np.float32] = ((sums[:, width:] - sums[:, :-width]) / width).astype(np.float32)
    return mean
