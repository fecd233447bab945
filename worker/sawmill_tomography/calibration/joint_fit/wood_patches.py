"""Patches of a drawing's wood, whose densities may differ: knots, a wet core or grain change the density in places."""

import math
from functools import lru_cache

import numpy as np

from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.phantoms.phantom import Phantom, Polygon, Shape, cornered, counter_clockwise, signed_area

# About this number of patches have the wood's area together (benchmarks/families.py), and none has a shorter side.
PATCHES, SHORTEST_MM = 130, 6.0
# A patch with a smaller share of wood is joined with the one next to it that has most.
FULL = 0.5
# Pieces with a smaller area have no inside.
LEAST_AREA_MM2 = 1e-3
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
    side = max(math.sqrt(max(wood, 0.0) / PATCHES), LEAST_SHARE * float(extent.max()), SHORTEST_MM)
    counts = np.ceil(extent / side).astype(int)
    sides = extent / counts
    patches: dict[tuple[int, int], tuple[Shape, ...]] = {}
    areas: dict[tuple[int, int], float] = {}
    for i, j in np.ndindex(*counts):
        corner = low + sides * [i, j]
        pieces = [(_clipped(outline, corner, corner + sides), density) for outline, density in outlines]
        pieces = [(piece, density) for piece, density in pieces if signed_area(piece) > LEAST_AREA_MM2]
        area = sum(signed_area(piece) * density for piece, density in pieces)
        if area > LEAST_AREA_MM2:
            patches[i, j] = tuple(Polygon(tuple(map(tuple, piece.tolist())), density) for piece, density in pieces)
            areas[i, j] = area
    for i, j in [place for place, area in areas.items() if area < FULL * sides.prod()]:
        beside = [place for place in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)) if place in patches]
        if beside:
            most = max(beside, key=areas.__getitem__)
            patches[most] += patches.pop((i, j))
            areas[most] += areas.pop((i, j))
    return tuple(patches.values())


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
