"""Motion of the phantom: its true position in each view."""

import math
from dataclasses import dataclass

import numpy as np

from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary.physics import MotionEffects


def direction(angle_deg: float) -> FloatArray:
    """Return the unit vector (2,) at this angle."""
    return np.array([math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))])


@dataclass(frozen=True, eq=False)
class Motion:
    """True angle of each view, and the phantom's displacement in it."""

    angles_rad: FloatArray  # (views,): True angles in the scanner's sense of rotation
    turn_rad: FloatArray  # (views,): turn of the phantom in the image, about the rotation centre
    offset_mm: FloatArray  # (views, 2): displacement in the image, and in the hall: across the beam and along it
    hall_mm: FloatArray  # (views, 2)
    slip_view: int | None  # the first view after the slip


def move(angles_rad: FloatArray, effects: MotionEffects, rng: np.random.Generator) -> Motion:
    """Draw the motion behind view angles that the scanner reports, (views,) in its sense of rotation."""
    views = angles_rad.size
    encoder = math.radians(effects.encoder_deg) * np.cos(angles_rad - math.radians(effects.encoder_phase_deg))
    jitter = math.radians(effects.angle_jitter_deg) * rng.standard_normal(views)
    turned = angles_rad + effects.pace_percent / 100.0 * (angles_rad - angles_rad[0]) + encoder + jitter
    slip_view = round(effects.slip_at * views) if effects.slip_mm or effects.slip_turn_deg else None
    slipped = (np.arange(views) >= (views if slip_view is None else slip_view)).astype(np.float64)
    slip = effects.slip_mm * slipped[:, None] * direction(effects.slip_towards_deg)
    creep = effects.creep_mm * np.linspace(0.0, 1.0, views)[:, None] * direction(effects.creep_towards_deg)
    wave = turned - math.radians(effects.wobble_phase_deg)
    swing = effects.wobble_once_mm * np.cos(wave) + effects.wobble_twice_mm * np.cos(2.0 * wave)
    hall = swing[:, None] * direction(effects.wobble_towards_deg)
    turn = math.radians(effects.slip_turn_deg) * slipped
    return Motion(turned, np.asarray(turn), np.asarray(slip + creep), hall, slip_view)
