"""The skin of a drawing's wood: what lies within some depth of the surface, as in wood that is drier there."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.phantoms.phantom import Disc, Phantom, Shape, counter_clockwise


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
