"""A drawing with rounded convex corners, as wear and saws make them, and with a skin of drier wood."""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.phantoms.phantom import Disc, Phantom, Polygon, Shape, counter_clockwise

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
        arc = centre + fitted * np.stack([np.cos(bends), np.sin(bends)], -1)
        pieces.append(np.concatenate([corner[None], arc]))
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
