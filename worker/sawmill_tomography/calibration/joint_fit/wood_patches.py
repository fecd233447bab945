"""A drawing's wood as it is: patches of other density and their spread, rounded corners, and a skin of drier wood."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.phantoms.phantom import Disc, Phantom, Polygon, Shape, cornered, counter_clockwise, signed_area
from sawmill_tomography.statistics import exceeded_chi_square

# About this number of patches have the wood's area together (benchmarks/families.py).
PATCHES = 130
# A patch with a smaller share of wood is joined with the one next to it that has most.
FULL = 0.5
# The side of a patch is at least this share of the drawing's longer side, for drawings with little wood.
LEAST_SHARE = 1 / 24


# A joint fit needs the same patches at every step.
@lru_cache(maxsize=4)
def wood_patches(phantom: Phantom) -> tuple[tuple[Shape, ...], ...]:
    """Divide a phantom by a grid of squares; return the shapes in each, which together are the phantom."""
    outlines = [(counter_clockwise(cornered(shape)), shape.density) for shape in phantom.shapes]
    corners = np.concatenate([outline for outline, _ in outlines])
    low, extent = corners.min(axis=0), np.ptp(corners, axis=0)
    wood = sum(signed_area(outline) * density for outline, density in outlines)
    side = max(math.sqrt(max(wood, 0.0) / PATCHES), LEAST_SHARE * float(extent.max()))
    counts = np.ceil(extent / side).astype(int)
    sides = extent / counts
    rounding = math.sqrt(np.finfo(np.float64).eps) * sides.prod()  # pieces with a smaller area have no inside
    patches: dict[tuple[int, int], tuple[Shape, ...]] = {}
    areas: dict[tuple[int, int], float] = {}
    for i, j in np.ndindex(*counts):
        corner = low + sides * [i, j]
        pieces = [(_clipped(outline, corner, corner + sides), density) for outline, density in outlines]
        pieces = [(piece, density) for piece, density in pieces if signed_area(piece) > rounding]
        area = sum(signed_area(piece) * density for piece, density in pieces)
        if area > rounding:
            patches[i, j] = tuple(Polygon(tuple(map(tuple, piece.tolist())), density) for piece, density in pieces)
            areas[i, j] = area
    for i, j in [place for place, area in areas.items() if area < FULL * sides.prod()]:
        beside = [place for place in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)) if place in patches]
        if beside:
            most = max(beside, key=areas.__getitem__)
            patches[most] += patches.pop((i, j))
            areas[most] += areas.pop((i, j))
    return tuple(patches.values())


def patch_side_mm(phantom: Phantom) -> float:
    """Return the side of a square as large as a phantom's patches are in the mean, mm."""
    area = sum(signed_area(counter_clockwise(cornered(shape))) * shape.density for shape in phantom.shapes)
    return math.sqrt(max(area, 0.0) / len(wood_patches(phantom)))


def _clipped(corners: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the part of a polygon (corners, 2) inside a rectangle (Sutherland and Hodgman 1974)."""
    for axis in range(2):
        for way, limit in ((1.0, low[axis]), (-1.0, high[axis])):
            depth = way * (corners[:, axis] - limit)
            kept = []
            for one, other, here, there in zip(
                corners, np.roll(corners, -1, axis=0), depth, np.roll(depth, -1), strict=True
            ):
                if here >= 0.0:
                    kept.append(one)
                if (here >= 0.0) != (there >= 0.0):
                    kept.append(one + here / (here - there) * (other - one))
            corners = np.array(kept).reshape(-1, 2)
    return corners


# Standard deviations that are compared, as a share of the wood's density.
DEVIATIONS = np.geomspace(1e-3, 0.2, 60)


@dataclass(frozen=True)
class Variation:
    """How much the wood's density varies from patch to patch."""

    deviation: float  # standard deviation, as a share of the wood's density
    likelihood: float  # twice the logarithm of the likelihood ratio against wood of one density
    largest: float  # the largest standard deviation that is not excluded with 95 %, by the likelihood ratio


def variation(normal: FloatArray, score: FloatArray, noise: float) -> Variation:
    """Estimate the variation by the largest restricted likelihood (Patterson and Thompson 1971).

    Each combination of patches that the scan shows on its own has an estimate of the deviation; these are compared.
    `normal` (patches, patches), `score` (patches,): normal equations of the densities, from densities of 0, next to the
    columns of the fit.
    """
    if noise <= 0.0:
        return Variation(float(DEVIATIONS[0]), 0.0, float(DEVIATIONS[0]))
    values, vectors = np.linalg.eigh(normal)
    kept = values > values.size * np.finfo(np.float64).eps * values[-1]
    values, seen = values[kept], vectors[:, kept].T @ score
    expected = noise * values + np.concatenate([[0.0], DEVIATIONS])[:, None] ** 2 * values**2
    uniform, *misfits = (np.log(expected) + seen**2 / expected).sum(axis=1).tolist()
    best = int(np.argmin(misfits))
    largest = DEVIATIONS[np.array(misfits) < misfits[best] + exceeded_chi_square(2 * 0.05, 1)].max()
    return Variation(float(DEVIATIONS[best]), uniform - misfits[best], float(largest))


ARC_POINTS = 7


# A joint fit needs the same drawing at every step.
@lru_cache(maxsize=4)
def with_rounded_corners(phantom: Phantom, radius_mm: float) -> Phantom:
    """Add pieces of negative density to every convex corner of the wood, so that arcs of this radius remain."""
    if radius_mm == 0.0:
        return phantom
    pieces = [
        Polygon(tuple(map(tuple, piece.tolist())), -shape.density)
        for shape in phantom.shapes
        if isinstance(shape, Polygon) and shape.density > 0.0
        for piece in _pieces(np.array(shape.vertices_mm), radius_mm)
    ]
    return replace(phantom, shapes=(*phantom.shapes, *pieces)) if pieces else phantom


def _pieces(corners: FloatArray, radius: float) -> list[FloatArray]:
    """Compute the pieces that the arcs cut off: polygons from a corner along one edge, and back along the arc."""
    x, y = corners[:, 0], corners[:, 1]
    sense = math.copysign(1.0, float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)))
    pieces = []
    for before, corner, after in zip(np.roll(corners, 1, axis=0), corners, np.roll(corners, -1, axis=0), strict=True):
        back, on = before - corner, after - corner
        if sense * (-back[0] * on[1] + back[1] * on[0]) <= 0.0:  # the wood turns inwards here
            continue
        a, b = back / np.hypot(*back), on / np.hypot(*on)
        half = 0.5 * math.acos(float(np.clip(a @ b, -1.0, 1.0)))
        reach = min(radius / math.tan(half), 0.45 * float(np.hypot(*back)), 0.45 * float(np.hypot(*on)))
        fitted = reach * math.tan(half)
        centre = corner + fitted / math.sin(half) * (a + b) / np.hypot(*(a + b))
        start, stop = corner + reach * a - centre, corner + reach * b - centre
        first = math.atan2(start[1], start[0])
        bends = first + math.remainder(math.atan2(stop[1], stop[0]) - first, 2.0 * math.pi) * np.linspace(
            0.0, 1.0, ARC_POINTS
        )
        pieces.append(np.concatenate([corner[None], centre + fitted * np.stack([np.cos(bends), np.sin(bends)], -1)]))
    return pieces


# A joint fit needs the same skins at every step.
@lru_cache(maxsize=8)
def skin(phantom: Phantom, depth_mm: float) -> tuple[Shape, ...]:
    """Return shapes that add up to the wood's density within this depth of the surface, and to 0 below.

    The surface is the outline of every shape of wood; holes have no skin. No shapes are returned where the wood is so
    thin, or its outline so rough, that the depth would take an edge away.
    """
    shapes: list[Shape] = []
    for shape in phantom.shapes:
        if shape.density > 0.0:
            core = _inset(shape, depth_mm)
            if core is None:
                return ()
            shapes += [shape, replace(core, density=-shape.density)]
    return tuple(shapes)


def _inset(shape: Shape, depth_mm: float) -> Shape | None:
    """Return the part of a shape that is deeper than this; None where a disc or an edge vanishes."""
    if isinstance(shape, Disc):
        return replace(shape, radius_mm=shape.radius_mm - depth_mm) if shape.radius_mm > depth_mm else None
    corners = counter_clockwise(shape)
    along = np.roll(corners, -1, axis=0) - corners
    along = along / np.hypot(*along.T)[:, None]
    inwards = np.stack([-along[:, 1], along[:, 0]], -1)
    # A corner moves to where the two edges at it meet after they have moved.
    facing = 1.0 + (np.roll(inwards, 1, axis=0) * inwards).sum(axis=1, keepdims=True)
    moved: FloatArray = corners + depth_mm * (np.roll(inwards, 1, axis=0) + inwards) / np.maximum(facing, 1e-9)
    lengths = ((np.roll(moved, -1, axis=0) - moved) * along).sum(axis=1)
    return replace(shape, vertices_mm=tuple(map(tuple, moved.tolist()))) if (lengths > 0.0).all() else None
