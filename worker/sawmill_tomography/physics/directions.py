"""Directions in the image and in the hall."""

import math

import numpy as np

from sawmill_tomography.geometry.geometry import FloatArray


def direction(angle_deg: float) -> FloatArray:
    """Return the unit vector (2,) at this angle."""
    return np.array([math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))])
