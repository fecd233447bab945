"""Scans by exact chords of rays, which share nothing with the forward model but the phantom's corners and discs."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.phantoms.phantom import Polygon, Shape
from sawmill_vocabulary import DetectorModule, SourceFrame

Array = NDArray[np.float64]
# A calibration's, near that of the published scanner.
FRAME = SourceFrame(0.3, 917.1, 1619.3, -109.1, -0.083)


def full_turn(views: int) -> Array:
    """Return the angles of views all round, the first at 0."""
    return np.linspace(0.0, 2.0 * np.pi, views, endpoint=False)


@dataclass(frozen=True)
class Detector:
    """Cells of modules, as points along a bent line (docs/look-up/conventions.md#modules)."""

    cells: int
    pitch_mm: float
    modules: tuple[DetectorModule, ...] = ()

    def points(self, frame: SourceFrame, rays: int) -> Array:
        """Return the ends of `rays` rays of each cell, (cells, rays, 2), the source at 0 and the COR on the y axis."""
        middle = self.cells // 2
        places = np.empty((self.cells, rays, 2))
        starts = {module.first_cell: module for module in self.modules}
        foot = np.array([0.0, frame.source_to_detector_mm])
        towards = np.array([math.cos(frame.tilt_rad), math.sin(frame.tilt_rad)])
        # The border before the middle cell lies at u = (middle - cells / 2) pitch.
        border = foot + towards * ((middle - 0.5 * self.cells) * self.pitch_mm - frame.cor_column_mm)
        inside = (np.arange(rays) + 0.5) / rays
        end, along = border, towards
        for cell in range(middle, self.cells):
            if cell in starts and cell > middle:
                end = end + starts[cell].gap_mm * along
                along = _turned(along, starts[cell].kink_rad)
            places[cell] = end + along * (inside * self.pitch_mm)[:, None]
            end = end + along * self.pitch_mm
        end, along = border, towards
        for cell in range(middle - 1, -1, -1):
            if cell + 1 in starts:
                end = end - starts[cell + 1].gap_mm * along
                along = _turned(along, -starts[cell + 1].kink_rad)
            end = end - along * self.pitch_mm
            places[cell] = end + along * (inside * self.pitch_mm)[:, None]
        return places


@dataclass(frozen=True)
class BentDetector(Detector):
    """Cells on an arc that touches the line at the detector's middle, or shifted along it."""

    radius_mm: float = math.inf
    shifts_mm: Array | float = 0.0  # (cells,)

    def points(self, frame: SourceFrame, rays: int) -> Array:
        """Return the ends of the rays, as those of a straight detector."""
        inside = (np.arange(rays) + 0.5) / rays
        first = np.arange(self.cells)[:, None] - 0.5 * self.cells
        at = (first + inside) * self.pitch_mm + np.broadcast_to(self.shifts_mm, self.cells)[:, None]
        depth = 0.0 * at
        if math.isfinite(self.radius_mm):
            at, depth = self.radius_mm * np.sin(at / self.radius_mm), self.radius_mm * (1 - np.cos(at / self.radius_mm))
        c, s = math.cos(frame.tilt_rad), math.sin(frame.tilt_rad)
        w = at - frame.cor_column_mm
        return np.stack([w * c + depth * s, frame.source_to_detector_mm + w * s - depth * c], -1)


def _turned(vector: Array, angle_rad: float) -> Array:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])


def monochromatic(paths: Array) -> Array:
    """Return the transmission of a beam of one energy along paths of these attenuations."""
    return np.exp(-paths)


def hardened(share: float) -> Callable[[Array], Array]:
    """Return a beam in which p attenuates as p - share p^2, and where that would fall again, as its largest value."""

    def beam(paths: Array) -> Array:
        seen = np.minimum(paths, 0.5 / share)
        return np.exp(-(seen - share * seen**2))

    return beam


def scan(
    shapes: Sequence[Shape],
    detector: Detector,
    frame: SourceFrame,
    angles_rad: Array,
    *,
    moved_mm: Array | float = 0.0,
    turned_rad: Array | float = 0.0,
    slope_per_mm: tuple[float, float] = (0.0, 0.0),
    beam: Callable[[Array], Array] = monochromatic,
    rays: int = 8,
) -> Array:
    """Compute the mean transmission of each cell, (views, cells).

    `moved_mm` is across and along the beam, `turned_rad` beyond the angles; `slope_per_mm` is relative.
    """
    ends = detector.points(frame, rays).reshape(-1, 2)
    towards = ends / np.hypot(ends[:, 0], ends[:, 1])[:, None]
    slopes = towards[:, 0] / towards[:, 1]
    views = len(angles_rad)
    offset = np.broadcast_to(moved_mm, (views, 2))
    turn = np.broadcast_to(turned_rad, (views,))
    out = np.empty((views, detector.cells))
    for view in range(views):
        beta = angles_rad[view] + frame.psi_rad + turn[view]
        paths = np.zeros(len(ends))
        # The density is 1 + slope . (point - origin), and a ray's point is its distance from the source times towards.
        c, s = math.cos(beta), math.sin(beta)
        slope = np.array([c * slope_per_mm[0] + s * slope_per_mm[1], c * slope_per_mm[1] - s * slope_per_mm[0]])
        at_source = 1.0 - slope @ _placed(np.zeros((1, 2)), beta, frame, offset[view])[0]
        for shape in shapes:
            if isinstance(shape, Polygon):
                corners = _placed(np.array(shape.vertices_mm, float), beta, frame, offset[view])
                # The rays run from left to right.
                across = corners[:, 0] / corners[:, 1]
                met = slice(*np.searchsorted(slopes, [across.min(), across.max()]))
                lengths, moments = _polygon_chords(corners, towards[met])
            else:
                met = slice(None)
                centre = _placed(np.array([shape.center_mm], float), beta, frame, offset[view])[0]
                across = towards[:, 0] * centre[1] - towards[:, 1] * centre[0]
                lengths = 2.0 * np.sqrt(np.maximum(shape.radius_mm**2 - across**2, 0.0))
                moments = lengths * (towards @ centre)
            paths[met] += shape.density * (at_source * lengths + (towards[met] @ slope) * moments)
        out[view] = beam(paths).reshape(detector.cells, rays).mean(axis=1)
    return out


def _placed(points: Array, beta: float, frame: SourceFrame, offset: Array) -> Array:
    c, s = math.cos(beta), math.sin(beta)
    x, y = points.T
    return np.stack([c * x + s * y + offset[0], c * y - s * x + frame.source_distance_mm + offset[1]], -1)


def _polygon_chords(corners: Array, towards: Array) -> tuple[Array, Array]:
    """Return the length of each ray from 0 inside a polygon, exits less entries, and its integral of the distance."""
    before, after = corners, np.roll(corners, -1, axis=0)
    side = towards[:, :1] * before[:, 1] - towards[:, 1:] * before[:, 0]
    side_after = towards[:, :1] * after[:, 1] - towards[:, 1:] * after[:, 0]
    crossing = (side > 0.0) != (side_after > 0.0)
    share = np.where(crossing, side / np.where(crossing, side - side_after, 1.0), 0.0)
    x = before[:, 0] + share * (after[:, 0] - before[:, 0])
    distance = x * towards[:, :1] + (before[:, 1] + share * (after[:, 1] - before[:, 1])) * towards[:, 1:]
    signs = np.where(side > side_after, 1.0, -1.0) * crossing
    lengths = (signs * distance).sum(axis=1)
    way = np.sign(lengths)
    return way * lengths, way * 0.5 * (signs * distance**2).sum(axis=1)


def slanted(corners: Array, source: Array, ends: Array, place: Array, slope: Array, roll: float) -> Array:
    """Return the chords (n,) of rays from (3,) to (n, 3) in a prism, as lengths in the prism's own cross-section.

    Its axis runs through `place` (2,) at height 0 along (slope, 1); it was rolled before it was slanted.
    """
    axis, c, s = np.array([*slope, 1.0]) / math.hypot(*slope, 1.0), math.cos(roll), math.sin(roll)
    rolled = np.array([[c, s, 0.0], [-s, c, 0.0]])
    # The least rotation that brings z to the axis (Rodrigues).
    own = (rolled - np.outer(rolled @ axis, np.add(axis, [0.0, 0.0, 1.0])) / (1.0 + axis[2])).T
    towards = (ends - source) @ own
    towards /= np.hypot(*towards.T)[:, None]
    return _polygon_chords(corners - (source - [*place, 0.0]) @ own, towards)[0]


def counted(transmission: Array, *, photons: float = 30_000.0, flats: int = 10, seed: int, gain: float = 0.1) -> Array:
    """Return line integrals from counts of these transmissions with noise, cells of unequal gain and flat fields."""
    rng = np.random.default_rng(seed)
    cells = transmission.shape[1]
    gains = 1.0 + gain * rng.standard_normal(cells).clip(-3.0, 3.0)
    flat = rng.poisson(photons * gains, (flats, cells)).mean(axis=0)
    lines: Array = -np.log(np.maximum(rng.poisson(photons * gains * transmission), 0.5) / flat)
    return lines
