"""The scanner's geometry: theta, the source frame, view angles, and the rays they make.

Axes, signs and formulas are those of section 3 of the design page: image[i, j] has x along i and y along j, in mm,
the centre of rotation (COR) is the origin, angles count counter-clockwise.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

TAU = 2.0 * math.pi
# Of theta's lengths in mm, and of its angle and slope, beyond which no scanner is and double precision loses the rays.
LARGEST = 1e5


class GeometryError(ValueError):
    """A geometry that cannot exist; the message says which value and what would be right."""


def rotate(angle_rad: ArrayLike, x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Rot(angle) (x, y), counter-clockwise; the arguments broadcast."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    return c * x - s * y, s * x + c * y


def wrap_angle(angle_rad: float) -> float:
    """The angle in [0, 2 pi)."""
    wrapped = math.fmod(angle_rad, TAU)
    wrapped = wrapped + TAU if wrapped < 0.0 else wrapped
    return 0.0 if wrapped >= TAU else wrapped


def angle_difference(a_rad: float, b_rad: float) -> float:
    """The signed difference a - b in [-pi, pi]."""
    return math.remainder(a_rad - b_rad, TAU)


@dataclass(frozen=True)
class Scanner:
    """What is known of a scanner without calibrating it."""

    source_to_cor_mm: float
    num_detector_pixels: int
    detector_pitch_mm: float

    def __post_init__(self) -> None:
        """Refuse sizes that no scanner has."""
        for name in ("source_to_cor_mm", "detector_pitch_mm"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise GeometryError(f"{name} must be a positive number of millimetres, not {value}")
        if self.num_detector_pixels < 2:
            raise GeometryError(f"num_detector_pixels must be at least 2, not {self.num_detector_pixels}")

    @property
    def cell_borders_mm(self) -> FloatArray:
        """Detector coordinate u of the cells' borders, (num_detector_pixels + 1,)."""
        n = self.num_detector_pixels
        return (np.arange(n + 1, dtype=np.float64) - 0.5 * n) * self.detector_pitch_mm

    @property
    def cell_centres_mm(self) -> FloatArray:
        """u_m = (m + 1/2 - n_D/2) pitch, (num_detector_pixels,)."""
        n = self.num_detector_pixels
        return (np.arange(n, dtype=np.float64) + 0.5 - 0.5 * n) * self.detector_pitch_mm


@dataclass(frozen=True)
class SourceFrame:
    """The geometry with the source on the axis: (psi, R, SDD, u_c, tau), what the data can see."""

    psi_rad: float
    source_distance_mm: float
    source_to_detector_mm: float
    cor_column_mm: float
    tilt_rad: float

    @property
    def magnification(self) -> float:
        """M = SDD / R."""
        return self.source_to_detector_mm / self.source_distance_mm

    def to_vector(self) -> FloatArray:
        """(psi, R, SDD, u_c, tau) as (5,) float64."""
        return np.array(
            [
                self.psi_rad,
                self.source_distance_mm,
                self.source_to_detector_mm,
                self.cor_column_mm,
                self.tilt_rad,
            ]
        )

    @classmethod
    def from_vector(cls, vector: Sequence[float] | FloatArray) -> Self:
        """The inverse of `to_vector`."""
        psi, r, sdd, u_c, tau = (float(value) for value in vector)
        return cls(psi, r, sdd, u_c, tau)

    def theta(self, source_to_cor_mm: float, *, source_shift_sign: int = 1) -> "Theta":
        """The theta of this frame with h_S of the given sign (design page, section 3).

        Raises
        ------
        GeometryError
            If R is smaller than r_S by more than rounding: no theta has such a frame.
        """
        r, r_s = self.source_distance_mm, source_to_cor_mm
        if r < r_s * (1.0 - 1e-12):
            raise GeometryError(
                f"source_distance_mm {r:.6g} is smaller than source_to_cor_mm {r_s:.6g}: no theta has this source frame"
            )
        h_s = math.copysign(math.sqrt(max(r * r - r_s * r_s, 0.0)), source_shift_sign)
        delta = math.atan2(h_s, r_s)
        distance = self.source_to_detector_mm - r
        c_x = -self.cor_column_mm * math.cos(self.tilt_rad)
        c_y = distance - self.cor_column_mm * math.sin(self.tilt_rad)
        d_x, d_y = rotate(delta, c_x, c_y)
        return Theta(
            initial_angle_rad=wrap_angle(self.psi_rad - delta),
            detector_to_cor_mm=float(d_y),
            source_shift_mm=h_s,
            detector_shift_mm=-float(d_x),
            detector_tilt=math.tan(self.tilt_rad + delta),
        )


@dataclass(frozen=True)
class Theta:
    """theta = (alpha0, r_D, h_S, h_D, alpha_D); the one place that knows their order."""

    initial_angle_rad: float
    detector_to_cor_mm: float
    source_shift_mm: float
    detector_shift_mm: float
    detector_tilt: float

    def to_vector(self) -> FloatArray:
        """(alpha0, r_D, h_S, h_D, alpha_D) as (5,) float64."""
        return np.array(
            [
                self.initial_angle_rad,
                self.detector_to_cor_mm,
                self.source_shift_mm,
                self.detector_shift_mm,
                self.detector_tilt,
            ]
        )

    @classmethod
    def from_vector(cls, vector: Sequence[float] | FloatArray) -> Self:
        """The inverse of `to_vector`."""
        alpha0, r_d, h_s, h_d, alpha_d = (float(value) for value in vector)
        return cls(alpha0, r_d, h_s, h_d, alpha_d)

    def source_frame(self, source_to_cor_mm: float) -> SourceFrame:
        """(psi, R, SDD, u_c, tau) of this theta (design page, section 3).

        Raises
        ------
        GeometryError
            If the ray through the COR runs along the detector or away from it.
        """
        delta = math.atan2(self.source_shift_mm, source_to_cor_mm)
        r = math.hypot(source_to_cor_mm, self.source_shift_mm)
        c_x, c_y = rotate(-delta, -self.detector_shift_mm, self.detector_to_cor_mm)
        tau = math.remainder(math.atan(self.detector_tilt) - delta, TAU)
        if math.cos(tau) < 1e-6:
            raise GeometryError(
                f"detector_tilt {self.detector_tilt:.6g} lays the detector along the ray through the centre of rotation"
            )
        u_c = -float(c_x) / math.cos(tau)
        distance = float(c_y) + u_c * math.sin(tau)
        if r + distance <= 0.0:
            raise GeometryError(f"detector_to_cor_mm {self.detector_to_cor_mm:.6g} puts the detector behind the source")
        return SourceFrame(wrap_angle(self.initial_angle_rad + delta), r, r + distance, u_c, tau)

    def twin(self, source_to_cor_mm: float) -> "Theta":
        """The other theta with exactly the same sinogram: h_S -> -h_S (design page, section 3)."""
        delta = math.atan2(self.source_shift_mm, source_to_cor_mm)
        x, y = rotate(-2.0 * delta, -self.detector_shift_mm, self.detector_to_cor_mm)
        return Theta(
            initial_angle_rad=wrap_angle(self.initial_angle_rad + 2.0 * delta),
            detector_to_cor_mm=float(y),
            source_shift_mm=-self.source_shift_mm,
            detector_shift_mm=-float(x),
            detector_tilt=math.tan(math.atan(self.detector_tilt) - 2.0 * delta),
        )

    def read_backwards(self) -> "Theta":
        """The theta of the same scan from a detector read backwards, with the rotation reversed, seen from behind."""
        return Theta(
            initial_angle_rad=wrap_angle(math.pi - self.initial_angle_rad),
            detector_to_cor_mm=self.detector_to_cor_mm,
            source_shift_mm=-self.source_shift_mm,
            detector_shift_mm=-self.detector_shift_mm,
            detector_tilt=-self.detector_tilt,
        )


@dataclass(frozen=True)
class ThetaBounds:
    """Where theta is searched; the published bounds by default (arXiv 2206.14444)."""

    detector_to_cor_mm: tuple[float, float] = (500.0, 1000.0)
    source_shift_mm: tuple[float, float] = (-500.0, 500.0)
    detector_shift_mm: tuple[float, float] = (-500.0, 500.0)
    detector_tilt: tuple[float, float] = (-1.0, 1.0)

    def __post_init__(self) -> None:
        """Refuse empty ranges."""
        for name in ("detector_to_cor_mm", "source_shift_mm", "detector_shift_mm", "detector_tilt"):
            low, high = getattr(self, name)
            if not low < high:
                raise GeometryError(f"the bounds of {name} must be (low, high) with low < high, not ({low}, {high})")

    def as_array(self) -> FloatArray:
        """(5, 2): the first angle over the full turn, then the four bounds."""
        return np.array(
            [
                (0.0, TAU),
                self.detector_to_cor_mm,
                self.source_shift_mm,
                self.detector_shift_mm,
                self.detector_tilt,
            ]
        )

    def contain(self, theta: Theta) -> bool:
        """Whether theta lies inside; the first angle is free."""
        vector, bounds = theta.to_vector()[1:], self.as_array()[1:]
        return bool(np.all((vector >= bounds[:, 0]) & (vector <= bounds[:, 1])))


@dataclass(frozen=True)
class FanBeamGeometry:
    """One source, one flat line detector, explicit view angles.

    Attributes
    ----------
    scanner : Scanner
        The known constants.
    theta : Theta
        The calibrated five.
    angles_rad : (views,) float64
        View k stands at angles_rad[k] beyond the initial angle. Reverse them (`Rotation.apply`) for a scanner that
        turns the other way.
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
            if not abs(value) <= LARGEST:  # nor is what is not a number
                raise GeometryError(f"{name} must lie between {-LARGEST:g} and {LARGEST:g}, not {value:.6g}")

    @property
    def frame(self) -> SourceFrame:
        """The source frame of theta."""
        return self.theta.source_frame(self.scanner.source_to_cor_mm)

    @property
    def sinogram_shape(self) -> tuple[int, int]:
        """(views, detector)."""
        return self.angles_rad.size, self.scanner.num_detector_pixels

    def with_angles(self, angles_rad: FloatArray) -> "FanBeamGeometry":
        """The same scanner at other view angles."""
        return replace(self, angles_rad=angles_rad)

    def vectors(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Source, detector centre and detector axis of each view, each (views, 2) in mm (axis: unit length)."""
        theta, beta = self.theta, self.angles_rad + self.theta.initial_angle_rad
        source = rotate(beta, theta.source_shift_mm, -self.scanner.source_to_cor_mm)
        centre = rotate(beta, -theta.detector_shift_mm, theta.detector_to_cor_mm)
        axis = rotate(beta, *(np.array([1.0, theta.detector_tilt]) / math.hypot(1.0, theta.detector_tilt)))
        return np.stack(source, -1), np.stack(centre, -1), np.stack(axis, -1)

    def astra_vectors(self) -> FloatArray:
        """Rows (srcX, srcY, dX, dY, uX, uY) of ASTRA's `fanflat_vec`, (views, 6), in mm.

        ASTRA's image has y up its rows and x along its columns, so image[i, j] with x along i is given to ASTRA
        unchanged when (x, y) is turned into (y, -x): rows run downwards in ASTRA's y.
        """
        source, centre, axis = self.vectors()
        step = axis * self.scanner.detector_pitch_mm

        def turn(v: FloatArray) -> FloatArray:
            return np.stack([v[:, 1], -v[:, 0]], -1)

        return np.concatenate([turn(source), turn(centre), turn(step)], axis=1)


def view_weights(angles_rad: FloatArray) -> FloatArray:
    """Half the circular gap to both neighbours of each view, (views,) rad, summing to 2 pi.

    Raises
    ------
    GeometryError
        If the views do not cover a full turn: the largest gap exceeds five medians.
    """
    wrapped = np.mod(np.asarray(angles_rad, np.float64), TAU)
    order = np.argsort(wrapped, kind="stable")
    gaps = np.diff(wrapped[order], append=wrapped[order[0]] + TAU)
    distinct = gaps[gaps > 1e-9]
    largest, median = float(gaps.max()), float(np.median(distinct))
    if wrapped.size < 3 or largest > 5.0 * median * (1.0 + 1e-9) or largest >= math.pi:
        raise GeometryError(
            f"the {wrapped.size} views leave a gap of {math.degrees(largest):.4g} degrees where their usual distance "
            f"is {math.degrees(median):.4g}: this reconstruction needs views all round the full turn"
        )
    weights = np.empty_like(gaps)
    weights[order] = 0.5 * (gaps + np.roll(gaps, 1))
    return weights
