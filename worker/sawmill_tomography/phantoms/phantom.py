"""Phantoms: bodies of known shape, polygons and discs in mm, whose projections the science computes."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import TAU, FloatArray, rotate
from sawmill_vocabulary import STANDARD_SIZE_TOLERANCE, Disc, Polygon, Shape

__all__ = ["Body", "Disc", "Phantom", "PhantomError", "Polygon", "Shape"]


# A polygon of this number of corners is a disc to 0.05 % of the radius.
CORNERS_PER_DISC = 96
# A parabola that bows by 1 mm differs from edges of this share of the phantom's radius by at most 0.0017 mm.
EDGES_PER_RADIUS = 12
# An outline is a circle if its distance from the centre changes by less than this share of the phantom's radius: more
# than the error of a traced picture, and far less than a hole off the centre.
ROUND = 1e-3
# Limit of a shape's density: sums of squares of line integrals stay far from a float's limits. Drawings are bounded
# more.
LARGEST_DENSITY = 1e6


class PhantomError(ValueError):
    """A phantom that cannot be used; the message gives the reason."""


MovePoint = Callable[[tuple[float, float]], tuple[float, float]]


def signed_area(vertices: FloatArray) -> float:
    """Return the area inside a polygon's corners (corners, 2), mm^2; negative where they go round clockwise."""
    x, y = (vertices - vertices[:1]).T
    return 0.5 * float(x[:-1] @ y[1:] - x[1:] @ y[:-1])


@dataclass(frozen=True, eq=False)
class Body:
    """What a projection needs of a phantom."""

    name: str
    edges: FloatArray  # (edges, 5), as `Phantom.edges`
    discs: FloatArray  # (discs, 4), as `Phantom.discs`
    radius_mm: float


@dataclass(frozen=True)
class Phantom:
    """A body made of shapes whose densities add: a hole is a shape of density -1.

    Attributes
    ----------
    name : str
        Name for reports.
    shapes : tuple of Polygon and Disc
        Shapes of the body.
    size_tolerance : float
        Relative standard uncertainty of the given size. The size sets the scanner's scale: R inherits the uncertainty.
    precision_mm : float
        How far the drawn outline may be from the body's: half the diagonal of a pixel, of a drawing made of pixels.
    """

    name: str
    shapes: tuple[Shape, ...]
    size_tolerance: float = STANDARD_SIZE_TOLERANCE
    precision_mm: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a phantom without shapes, and shapes without an interior."""
        if not self.shapes:
            raise PhantomError(f"the phantom {self.name!r} has no shapes")
        for shape in self.shapes:
            _refuse_without_inside(shape)

    def mirrored(self) -> "Phantom":
        """Return the phantom from behind: y -> -y."""
        return self._mapped(1.0, -1.0, 0.0, 0.0)

    def moved(self, x_mm: float, y_mm: float) -> "Phantom":
        """Return the phantom shifted by (x, y)."""
        return self._mapped(1.0, 1.0, x_mm, y_mm)

    def centred(self) -> "Phantom":
        """Return the phantom with its centre of gravity at the origin."""
        x_mm, y_mm = self.centroid_mm
        return self.moved(-x_mm, -y_mm)

    def scaled(self, factor: float) -> "Phantom":
        """Return the phantom with every length times factor."""
        shapes = tuple(
            replace(shape, radius_mm=shape.radius_mm * factor) if isinstance(shape, Disc) else shape
            for shape in self.shapes
        )
        return replace(self, shapes=shapes)._mapped(factor, factor, 0.0, 0.0)  # noqa: SLF001 - its own class

    def of_density(self, factor: float) -> "Phantom":
        """Return the phantom with every density times factor: a drawing's wood becomes attenuation per mm."""
        return replace(self, shapes=tuple(replace(shape, density=shape.density * factor) for shape in self.shapes))

    def deformed(self, aspect: float, shear: float) -> "Phantom":
        """Return the phantom stretched by half the aspect (x longer, y shorter) and sheared by half the shear each way.

        The origin stays. To first order no area changes. Discs become polygons of the same area.
        """
        if aspect == 0.0 and shear == 0.0:
            return self
        shapes = tuple(cornered(shape) for shape in self.shapes)

        def move(point: tuple[float, float]) -> tuple[float, float]:
            x, y = point
            return x + 0.5 * (aspect * x + shear * y), y + 0.5 * (shear * x - aspect * y)

        return replace(self, shapes=tuple(_map_shape(shape, move) for shape in shapes))

    def warped(self, bow_mm: tuple[float, float], taper_mm: tuple[float, float], radius_mm: float) -> "Phantom":
        """Return the phantom bent in its plane, and wider at one end.

        With lengths in units of `radius_mm`, x moves by the first bow times y^2 and the first taper times 2 x y, and y
        by the second bow times x^2 and the second taper times 2 x y. Discs become polygons of the same area. Edges are
        divided, since they become parabolas.
        """
        if not any((*bow_mm, *taper_mm)):
            return self
        shapes = []
        for shape in map(cornered, self.shapes):
            corners = _divided(np.array(shape.vertices_mm, np.float64), radius_mm / EDGES_PER_RADIUS)
            x, y = (corners / radius_mm).T
            warped = corners + np.stack([y * y, x * x], -1) * bow_mm + (2.0 * x * y)[:, None] * taper_mm
            shapes.append(Polygon(tuple(map(tuple, warped.tolist())), shape.density))
        return replace(self, shapes=tuple(shapes))

    def rotated(self, angle_rad: float) -> "Phantom":
        """Return the phantom turned counter-clockwise about the origin."""

        def turn(point: tuple[float, float]) -> tuple[float, float]:
            x, y = rotate(angle_rad, *point)
            return float(x), float(y)

        return replace(self, shapes=tuple(_map_shape(shape, turn) for shape in self.shapes))

    def _mapped(self, a: float, b: float, x_mm: float, y_mm: float) -> "Phantom":
        def move(point: tuple[float, float]) -> tuple[float, float]:
            return a * point[0] + x_mm, b * point[1] + y_mm

        return replace(self, shapes=tuple(_map_shape(shape, move) for shape in self.shapes))

    @cached_property
    def edges(self) -> FloatArray:
        """Polygon edges, counter-clockwise: (edges, 5) rows (xA, yA, xB, yB, density)."""
        rows = []
        for shape in self.shapes:
            if isinstance(shape, Polygon):
                corners = counter_clockwise(shape)
                density = np.full((len(corners), 1), shape.density)
                rows.append(np.concatenate([corners, np.concatenate([corners[1:], corners[:1]]), density], axis=1))
        return np.concatenate(rows) if rows else np.zeros((0, 5))

    @cached_property
    def discs(self) -> FloatArray:
        """Discs: (discs, 4) rows (x, y, radius, density)."""
        rows = [(*shape.center_mm, shape.radius_mm, shape.density) for shape in self.shapes if isinstance(shape, Disc)]
        return np.array(rows, np.float64).reshape(-1, 4)

    @cached_property
    def centroid_mm(self) -> tuple[float, float]:
        """Centre of gravity."""
        weight, moment = 0.0, np.zeros(2)
        for shape in self.shapes:
            if isinstance(shape, Disc):
                area, centre = math.pi * shape.radius_mm**2, np.array(shape.center_mm)
            else:
                v = np.array(shape.vertices_mm)
                w = np.roll(v, -1, axis=0)
                cross = v[:, 0] * w[:, 1] - w[:, 0] * v[:, 1]
                area = 0.5 * float(cross.sum())
                centre, area = ((v + w) * cross[:, None]).sum(axis=0) / (6.0 * area), abs(area)
            weight, moment = weight + shape.density * area, moment + shape.density * area * centre
        return (float(moment[0] / weight), float(moment[1] / weight)) if weight else (0.0, 0.0)

    @cached_property
    def radius_mm(self) -> float:
        """Radius of the smallest disc around the origin that holds the phantom."""
        reach = [math.hypot(*shape.center_mm) + shape.radius_mm for shape in self.shapes if isinstance(shape, Disc)]
        reach += [math.hypot(*corner) for s in self.shapes if isinstance(s, Polygon) for corner in s.vertices_mm]
        return max(reach)

    @cached_property
    def is_round(self) -> bool:
        """True if the phantom looks the same from every side: discs, and polygons like discs, about one centre."""
        distances = [
            np.hypot(*(np.concatenate([line, 0.5 * (line[1:] + line[:-1])]) - self.centroid_mm).T)
            for line in self.outlines()
        ]
        largest = max(float(distance.max()) for distance in distances)
        return all(float(np.ptp(distance)) <= ROUND * largest for distance in distances)

    def outlines(self, *, points_per_disc: int = 181) -> list[FloatArray]:
        """Return closed outlines for drawing, each (points, 2) in mm, the first point repeated at the end."""
        lines = []
        turn = np.linspace(0.0, TAU, points_per_disc)
        for shape in self.shapes:
            if isinstance(shape, Polygon):
                lines.append(np.array([*shape.vertices_mm, shape.vertices_mm[0]], np.float64))
            else:
                lines.append(np.array(shape.center_mm) + shape.radius_mm * np.stack([np.cos(turn), np.sin(turn)], -1))
        return lines

    def rasterise(self, size: int, field_mm: float, *, subsamples: int = 4) -> NDArray[np.float32]:
        """Return the mean density in each pixel of a (size, size) image [x, y] over a centred square field.

        The test uses `subsamples` points along each side of a pixel, so an edge pixel is right to 1 / subsamples**2.
        """
        n = size * subsamples
        axis = (np.arange(n) + 0.5) * field_mm / n - 0.5 * field_mm
        fine = np.zeros((n, n), np.float32)
        for shape in self.shapes:
            fine += np.float32(shape.density) * _inside(shape, axis)
        return np.asarray(fine.reshape(size, subsamples, size, subsamples).mean(axis=(1, 3), dtype=np.float32))


def _refuse_without_inside(shape: Shape) -> None:
    if not abs(shape.density) <= LARGEST_DENSITY:
        raise PhantomError(f"a shape's density must lie within ±{LARGEST_DENSITY:g}, wood being 1, not {shape.density}")
    if isinstance(shape, Disc):
        if not (math.isfinite(shape.radius_mm) and shape.radius_mm > 0.0 and np.isfinite(shape.center_mm).all()):
            raise PhantomError(f"a disc needs a positive radius and a finite centre in mm, not {shape}")
    elif len(shape.vertices_mm) < 3 or not math.isfinite(shape.area_mm2):
        raise PhantomError("a polygon needs at least three corners with finite coordinates in mm")
    elif shape.area_mm2 < 1e-6:
        raise PhantomError("a polygon's corners must enclose an area; these lie on one line")


def _divided(corners: FloatArray, longest_mm: float) -> FloatArray:
    """Return a polygon's corners (corners, 2) with further corners on the edges, none longer than `longest_mm`."""
    along = np.concatenate([corners[1:], corners[:1]]) - corners
    parts = np.maximum(np.ceil(np.hypot(*along.T) / longest_mm).astype(int), 1)
    number = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    return np.asarray(
        np.repeat(corners, parts, axis=0) + np.repeat(along / parts[:, None], parts, axis=0) * (number[:, None])
    )


def _map_shape(shape: Shape, move: MovePoint) -> Shape:
    if isinstance(shape, Disc):
        return replace(shape, center_mm=move(shape.center_mm))
    return replace(shape, vertices_mm=tuple(move(corner) for corner in shape.vertices_mm))


def counter_clockwise(shape: Polygon) -> FloatArray:
    """Return the polygon's corners (corners, 2), counter-clockwise whatever their order in the shape."""
    corners = np.array(shape.vertices_mm, np.float64)
    return corners if signed_area(corners) > 0.0 else corners[::-1]


def cornered(shape: Shape, corners_per_disc: int = CORNERS_PER_DISC) -> Polygon:
    """Return a polygon of the same area as a disc; polygons are returned as they are."""
    if isinstance(shape, Polygon):
        return shape
    step = TAU / corners_per_disc
    radius = shape.radius_mm * math.sqrt(step / math.sin(step))
    x, y = shape.center_mm
    corners = ((x + radius * math.cos(i * step), y + radius * math.sin(i * step)) for i in range(corners_per_disc))
    return Polygon(tuple(corners), shape.density)


def _inside(shape: Shape, axis: FloatArray) -> NDArray[np.bool_]:
    """Select the points (x, y) of axis x axis inside a shape, even-odd for polygons."""
    if isinstance(shape, Disc):
        dx, dy = axis - shape.center_mm[0], axis - shape.center_mm[1]
        return (dx * dx)[:, None] + (dy * dy)[None, :] < shape.radius_mm**2
    corners = np.array(shape.vertices_mm, np.float64)
    inside = np.zeros((axis.size, axis.size), bool)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        spanned = (axis >= min(x0, x1)) & (axis < max(x0, x1))
        if spanned.any():
            y_edge = y0 + (axis[spanned] - x0) * (y1 - y0) / (x1 - x0)
            inside[spanned] ^= axis[None, :] > y_edge[:, None]
    return inside
