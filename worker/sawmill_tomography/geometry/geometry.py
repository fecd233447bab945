"""The scanner's geometry: theta, the source frame, view angles, and the rays they make.

The value classes come from `sawmill_vocabulary` and are exported here for the science; this module adds the arrays.
Axes, signs and formulas: docs/look-up/conventions.md#axes. image[i, j] has x along i and y along j, in mm, the centre
of rotation (COR) is the origin, angles count counter-clockwise.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sawmill_vocabulary import (
    TAU,
    GeometryError,
    Scanner,
    SourceFrame,
    Theta,
    ThetaBounds,
    angle_difference,
    wrap_angle,
)

__all__ = [
    "TAU",
    "FanBeamGeometry",
    "FloatArray",
    "GeometryError",
    "Scanner",
    "SourceFrame",
    "Theta",
    "ThetaBounds",
    "all_round",
    "angle_difference",
    "bounds_array",
    "cell_borders_mm",
    "cell_centres_mm",
    "rotate",
    "to_vector",
    "view_weights",
    "wrap_angle",
]

FloatArray = NDArray[np.float64]

# Limit of theta's lengths in mm, and for the angle and the slope: no scanner exceeds it, and double precision loses the
# rays.
LARGEST = 1e5


def rotate(angle_rad: ArrayLike, x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return Rot(angle) (x, y), counter-clockwise; the arguments broadcast."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    return c * x - s * y, s * x + c * y


def to_vector(value: Theta | SourceFrame) -> FloatArray:
    """Return the five numbers in the order of the fields, (5,) float64; the inverse of `from_vector`."""
    return np.array([*vars(value).values()], np.float64)


def bounds_array(bounds: ThetaBounds) -> FloatArray:
    """Return bounds (5, 2): the first angle over the full turn in rad, then the four bounds, lengths in mm."""
    return np.array([(0.0, TAU), *vars(bounds).values()])


def cell_borders_mm(scanner: Scanner) -> FloatArray:
    """Return the detector coordinate u of the cells' borders, (cells + 1,) mm."""
    n = scanner.num_detector_pixels
    return (np.arange(n + 1, dtype=np.float64) - 0.5 * n) * scanner.detector_pitch_mm


def cell_centres_mm(scanner: Scanner) -> FloatArray:
    """Return u_m = (m + 1/2 - n_D/2) pitch of each cell m, (cells,) mm."""
    n = scanner.num_detector_pixels
    return (np.arange(n, dtype=np.float64) + 0.5 - 0.5 * n) * scanner.detector_pitch_mm


@dataclass(frozen=True)
class FanBeamGeometry:
    """A fan-beam geometry: one source, one flat line detector, explicit view angles.

    Attributes
    ----------
    scanner : Scanner
        Known constants of the scanner.
    theta : Theta
        The five calibrated numbers.
    angles_rad : (views,) float64
        View k is at angles_rad[k] beyond the initial angle. Reverse the angles (`Rotation.apply`) for a scanner that
        turns in the opposite sense.
    """

    scanner: Scanner
    theta: Theta
    angles_rad: FloatArray

    def __post_init__(self) -> None:
        """Refuse angles that are not a list of finite numbers, and a theta that no scanner has."""
        angles = np.ascontiguousarray(self.angles_rad, dtype=np.float64)
        if angles.ndim != 1 or angles.size == 0 or not np.isfinite(angles).all():
            raise GeometryError("angles_rad must be one finite number of radians for each view")
        object.__setattr__(self, "angles_rad", angles)
        for name, value in vars(self.theta).items():
            if not abs(value) <= LARGEST:  # true for nan too
                raise GeometryError(f"{name} must lie between {-LARGEST:g} and {LARGEST:g}, not {value:.6g}")

    @property
    def frame(self) -> SourceFrame:
        """The source frame of theta."""
        return self.theta.source_frame(self.scanner.source_to_cor_mm)

    @property
    def sinogram_shape(self) -> tuple[int, int]:
        """(views, cells)."""
        return self.angles_rad.size, self.scanner.num_detector_pixels

    def with_angles(self, angles_rad: FloatArray) -> "FanBeamGeometry":
        """Return the geometry of the same scanner at other view angles."""
        return replace(self, angles_rad=angles_rad)

    def vectors(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return source, detector centre and detector axis of each view, each (views, 2) in mm (axis: unit length)."""
        theta, phi = self.theta, self.angles_rad + self.theta.initial_angle_rad
        source = rotate(phi, theta.source_shift_mm, -self.scanner.source_to_cor_mm)
        centre = rotate(phi, -theta.detector_shift_mm, theta.detector_to_cor_mm)
        axis = rotate(phi, *(np.array([1.0, theta.detector_tilt]) / math.hypot(1.0, theta.detector_tilt)))
        return np.stack(source, -1), np.stack(centre, -1), np.stack(axis, -1)

    def astra_vectors(self) -> FloatArray:
        """Return rows (srcX, srcY, dX, dY, uX, uY) of ASTRA's `fanflat_vec`, (views, 6), in mm.

        ASTRA's image has y up its rows and x along its columns, so image[i, j] with x along i is given to ASTRA
        unchanged when (x, y) is turned into (y, -x): rows run downwards in ASTRA's y.
        """
        source, centre, axis = self.vectors()
        step = axis * self.scanner.detector_pitch_mm

        def turn(v: FloatArray) -> FloatArray:
            return np.stack([v[:, 1], -v[:, 0]], -1)

        return np.concatenate([turn(source), turn(centre), turn(step)], axis=1)


def view_weights(angles_rad: FloatArray) -> FloatArray:
    """Return half the circular gap to both neighbours of each view, (views,) rad, summing to 2 pi."""
    wrapped = np.mod(np.asarray(angles_rad, np.float64), TAU)
    order = np.argsort(wrapped, kind="stable")
    gaps = np.diff(wrapped[order], append=wrapped[order[0]] + TAU)
    largest, median = float(gaps.max()), float(np.median(gaps[gaps > 1e-9]))
    if wrapped.size < 3 or largest > 5.0 * median * (1.0 + 1e-9) or largest >= math.pi:
        raise GeometryError(
            f"the {wrapped.size} views leave a gap of {math.degrees(largest):.4g} degrees where their usual distance "
            f"is {math.degrees(median):.4g}: this reconstruction needs views all round the full turn"
        )
    weights = np.empty_like(gaps)
    weights[order] = 0.5 * (gaps + np.roll(gaps, 1))
    return weights


def all_round(angles_rad: FloatArray) -> bool:
    """Return whether the views cover a full turn, as `view_weights` requires."""
    try:
        view_weights(angles_rad)
    except GeometryError:
        return False
    return True
