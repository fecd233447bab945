"""Values of the scanner's geometry: constants, theta, the source frame, bounds of a search, a detector's estimate.

Each field is typed here once, with its unit, its description and its bounds. The science computes with these classes,
and the contracts take them as field types: pydantic reads the fields' metadata. Bounds in the metadata hold
where a value crosses a boundary, the checks of `__post_init__` everywhere.

Axes, signs and formulas: docs/look-up/conventions.md#source-frame.

Contracts and sentences write the tilt in degrees; everything else has radians.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import Annotated, Self

from annotated_types import Interval

from sawmill_vocabulary.choices import ObjectTurns
from sawmill_vocabulary.outlines import AsContract, described

TAU = 2.0 * math.pi
# The unit of an angle in a text.
DEGREES = "deg"
# Largest length at a scanner, mm.
LARGEST_MM = 1e5
# Fields of a scanner that say where the detector's cells are.
CELL_PLACES = ("detector_modules", "detector_arc_radius_mm", "detector_waves_mm")
# The number of waves by which a detector's cells may lie at unequal distances.
MOST_WAVES = 24
# Cells of detectors for logs have some tenths of a mm to some mm; no detector has wider ones.
WIDEST_CELL_MM = 20.0
# Between views farther apart than this the sinogram of a log is not sampled well enough to pair its rays; an encoder
# may scatter a step by 2 %.
WIDEST_STEP_DEG = 3.0
WIDEST_MEASURED_STEP_DEG = 1.02 * WIDEST_STEP_DEG
# Fewest views of which any two are compared for drift, however far apart.
FEWEST_PAIRED_VIEWS = 8


class GeometryError(ValueError):
    """A geometry that cannot exist; the message names the value and what would be right."""


def wrap_angle(angle_rad: float) -> float:
    """Wrap an angle to [0, 2 pi)."""
    wrapped = math.fmod(angle_rad, TAU)
    wrapped = wrapped + TAU if wrapped < 0.0 else wrapped
    return 0.0 if wrapped >= TAU else wrapped


def _angle_rad(text: str) -> float:
    """Read an angle in radians, or in degrees if it ends with `deg`."""
    return math.radians(float(text.removesuffix(DEGREES))) if text.endswith(DEGREES) else float(text)


def _slope(text: str) -> float:
    """Read a slope, or an angle in degrees if it ends with `deg`."""
    return math.tan(_angle_rad(text)) if text.endswith(DEGREES) else float(text)


def angle_difference(a_rad: float, b_rad: float) -> float:
    """Return the signed difference a - b in [-pi, pi]."""
    return math.remainder(a_rad - b_rad, TAU)


def _rotate(angle_rad: float, x: float, y: float) -> tuple[float, float]:
    """Rotate (x, y) by Rot(angle), counter-clockwise."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return c * x - s * y, s * x + c * y


@dataclass(frozen=True)
class DetectorModule(AsContract):
    """A module of the line detector after the first, as it stands against the module before.

    Positions count from the module that holds the detector's middle (docs/look-up/conventions.md#modules).
    """

    first_cell: int = field(
        metadata=described("First cell of the module, counted from 0.", ge=1, le=65535, examples=[384])
    )
    gap_mm: float = field(
        default=0.0,
        metadata=described(
            "Distance between the module's first cell and the cell before, beyond the detector pitch, mm.",
            ge=-1000,
            le=1000,
            examples=[0.35],
        ),
    )
    kink_rad: float = field(
        default=0.0,
        metadata=described(
            "Angle of the module against the module before, counter-clockwise, rad.", ge=-0.5, le=0.5, examples=[0.002]
        ),
    )


@dataclass(frozen=True)
class Scanner(AsContract):
    """Known constants of a scanner, which no calibration determines."""

    source_to_cor_mm: float = field(
        metadata=described("r_S, source to centre of rotation, mm.", gt=0, le=LARGEST_MM, examples=[859.46])
    )
    num_detector_pixels: int = field(
        metadata=described("n_D, number of detector cells.", ge=8, le=65536, examples=[768])
    )
    detector_pitch_mm: float = field(
        metadata=described(
            "Distance between neighbouring detector cells, mm.", gt=0, le=LARGEST_MM, examples=[1.502864583]
        )
    )
    detector_modules: tuple[DetectorModule, ...] = field(
        default=(),
        metadata=described(
            "Modules of the line detector after the first, in the order of the cells; empty: one "
            "module. A calibration starts from these gaps and kinks and adds what the scan shows.",
            max_length=64,
        ),
    )
    detector_arc_radius_mm: float | None = field(
        default=None,
        metadata=described(
            "Radius of the arc on which the detector's cells lie, around a point on the source's side, "
            "mm; null: a straight line. The detector pitch counts along the arc.",
            gt=0,
            le=LARGEST_MM,
            examples=[1574.0],
        ),
    )
    detector_waves_mm: tuple[Annotated[float, Interval(ge=-LARGEST_MM, le=LARGEST_MM)], ...] = field(
        default=(),
        repr=False,
        metadata=described(
            "How far the cells lie from equal distances, mm: the sum of these numbers times "
            "cos(pi k (m + 1/2) / num_detector_pixels), cells m counting from 0, and k from 2 for the first number.",
            max_length=MOST_WAVES,
            examples=[[0.12, -0.05]],
        ),
    )
    object_turns: ObjectTurns = field(
        default=ObjectTurns.IN_ONE_SCAN,
        metadata=described(
            "When the object turns: in one scan, on a turntable, or between passages through the "
            "scanner, one for each view, so that it stands a little elsewhere in each view.",
            examples=["in-one-scan"],
        ),
    )

    def with_cells_of(self, other: "Scanner") -> Self:
        """Return the scanner with the places of another's cells: modules, arc and waves."""
        return replace(self, **{name: getattr(other, name) for name in CELL_PLACES})

    @property
    def with_equal_cells(self) -> Self:
        """The scanner with cells at equal distances on a straight line."""
        return replace(self, detector_modules=(), detector_arc_radius_mm=None, detector_waves_mm=())

    def __post_init__(self) -> None:
        """Refuse sizes that no scanner has, and modules that are not in the order of the cells."""
        for name in ("source_to_cor_mm", "detector_pitch_mm"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise GeometryError(f"{name} must be a positive number of millimetres, not {value}")
        if self.num_detector_pixels < 2:
            raise GeometryError(f"num_detector_pixels must be at least 2, not {self.num_detector_pixels}")
        least_mm = self.num_detector_pixels * self.detector_pitch_mm / math.pi
        if not all(abs(wave) <= self.detector_pitch_mm * self.num_detector_pixels for wave in self.detector_waves_mm):
            raise GeometryError(
                f"detector_waves_mm must be numbers of mm, smaller than the detector, not "
                f"{list(self.detector_waves_mm)}"
            )
        if self.detector_arc_radius_mm is not None and not self.detector_arc_radius_mm > least_mm:
            raise GeometryError(
                f"detector_arc_radius_mm must be larger than {least_mm:.6g}, where the detector is half a circle, not "
                f"{self.detector_arc_radius_mm}"
            )
        first_cells = [0, *(module.first_cell for module in self.detector_modules), self.num_detector_pixels]
        if any(after <= before for before, after in pairwise(first_cells)):
            raise GeometryError(
                f"the first cells of detector_modules must increase, from 1 to {self.num_detector_pixels - 1}, not "
                f"{first_cells[1:-1]}"
            )


@dataclass(frozen=True)
class SourceFrame(AsContract):
    """The geometry with the source on the axis: (psi, R, SDD, u_c, tau), what the data can see."""

    psi_rad: float = field(metadata=described("psi, first angle in the source frame, rad.", examples=[2.907]))
    source_distance_mm: float = field(
        metadata=described("R, source to centre of rotation along the axis, mm.", examples=[917.1])
    )
    source_to_detector_mm: float = field(
        metadata=described("SDD along the ray through the centre of rotation, mm.", examples=[1619.3])
    )
    cor_column_mm: float = field(
        metadata=described(
            "u_c, where the centre of rotation falls on the detector, mm from its middle.", examples=[-209.1]
        )
    )
    tilt_rad: float = field(
        metadata=described(
            "tau, tilt of the detector against the normal of the ray through the centre of rotation, rad.",
            examples=[-0.083],
        )
    )

    @property
    def magnification(self) -> float:
        """Magnification M = SDD / R."""
        return self.source_to_detector_mm / self.source_distance_mm

    @classmethod
    def from_vector(cls, vector: Iterable[float]) -> Self:
        """Build the frame from (psi, R, SDD, u_c, tau); the inverse of `tomography.geometry.to_vector`."""
        psi, r, sdd, u_c, tau = (float(value) for value in vector)
        return cls(psi, r, sdd, u_c, tau)

    def theta(self, source_to_cor_mm: float, *, source_shift_sign: int = 1) -> "Theta":
        """Return the theta of this frame with h_S of the given sign."""
        r, r_s = self.source_distance_mm, source_to_cor_mm
        if r < r_s * (1.0 - 1e-12):
            raise GeometryError(
                f"source_distance_mm {r:.6g} is smaller than source_to_cor_mm {r_s:.6g}: no theta has this source frame"
            )
        h_s = math.copysign(math.sqrt(max(r * r - r_s * r_s, 0.0)), source_shift_sign)
        delta = math.atan2(h_s, r_s)
        distance = self.source_to_detector_mm - r
        c_x = -self.cor_column_mm * math.cos(self.tilt_rad)
        d_x, d_y = _rotate(delta, c_x, distance - self.cor_column_mm * math.sin(self.tilt_rad))
        return Theta(
            initial_angle_rad=wrap_angle(self.psi_rad - delta),
            detector_to_cor_mm=d_y,
            source_shift_mm=h_s,
            detector_shift_mm=-d_x,
            detector_tilt=math.tan(self.tilt_rad + delta),
        )


@dataclass(frozen=True)
class Theta(AsContract):
    """The five numbers that cannot be measured by hand: theta = (alpha0, r_D, h_S, h_D, alpha_D)."""

    initial_angle_rad: float = field(metadata=described("alpha0, rad, in [0, 2 pi).", examples=[2.55]))
    detector_to_cor_mm: float = field(metadata=described("r_D, detector to centre of rotation, mm.", examples=[714.7]))
    source_shift_mm: float = field(metadata=described("h_S, sideways shift of the source, mm.", examples=[319.9]))
    detector_shift_mm: float = field(
        metadata=described("h_D, sideways shift of the detector, mm, counted the other way than h_S.", examples=[43.7])
    )
    detector_tilt: float = field(
        metadata=described("alpha_D, a slope without unit: the tilt angle is its arctangent.", examples=[0.281])
    )

    @classmethod
    def from_vector(cls, vector: Iterable[float]) -> Self:
        """Build theta from (alpha0, r_D, h_S, h_D, alpha_D); the inverse of `tomography.geometry.to_vector`."""
        alpha0, r_d, h_s, h_d, alpha_d = (float(value) for value in vector)
        return cls(alpha0, r_d, h_s, h_d, alpha_d)

    @classmethod
    def numbers(cls, text: str) -> dict[str, float]:
        """Read the fields from numbers separated by commas, angles as 146.1deg or in radians; or raise ValueError."""
        read = {"initial_angle_rad": _angle_rad, "detector_tilt": _slope}
        parts = zip((one.name for one in fields(cls)), text.split(","), strict=True)
        return {name: read.get(name, float)(part) for name, part in parts}

    def written(self, digits: int = 8) -> str:
        """Write the five numbers as `numbers` reads them."""
        angles = (math.degrees(self.initial_angle_rad), math.degrees(math.atan(self.detector_tilt)))
        lengths = (self.detector_to_cor_mm, self.source_shift_mm, self.detector_shift_mm)
        first, *others = (f"{value:.{digits}g}" for value in (angles[0], *lengths))
        return f"{first}deg,{','.join(others)},{angles[1]:.{digits - 2}g}deg"

    def source_frame(self, source_to_cor_mm: float) -> SourceFrame:
        """Return the source frame (psi, R, SDD, u_c, tau) of this theta."""
        delta = math.atan2(self.source_shift_mm, source_to_cor_mm)
        r = math.hypot(source_to_cor_mm, self.source_shift_mm)
        c_x, c_y = _rotate(-delta, -self.detector_shift_mm, self.detector_to_cor_mm)
        tau = math.remainder(math.atan(self.detector_tilt) - delta, TAU)
        if math.cos(tau) < 1e-6:
            raise GeometryError(
                f"detector_tilt {self.detector_tilt:.6g} lays the detector along the ray through the centre of rotation"
            )
        u_c = -c_x / math.cos(tau)
        distance = c_y + u_c * math.sin(tau)
        if r + distance <= 0.0:
            raise GeometryError(f"detector_to_cor_mm {self.detector_to_cor_mm:.6g} puts the detector behind the source")
        return SourceFrame(wrap_angle(self.initial_angle_rad + delta), r, r + distance, u_c, tau)

    def twin(self, source_to_cor_mm: float) -> "Theta":
        """Return the other theta with exactly the same sinogram: h_S -> -h_S."""
        delta = math.atan2(self.source_shift_mm, source_to_cor_mm)
        x, y = _rotate(-2.0 * delta, -self.detector_shift_mm, self.detector_to_cor_mm)
        return Theta(
            initial_angle_rad=wrap_angle(self.initial_angle_rad + 2.0 * delta),
            detector_to_cor_mm=y,
            source_shift_mm=-self.source_shift_mm,
            detector_shift_mm=-x,
            detector_tilt=math.tan(math.atan(self.detector_tilt) - 2.0 * delta),
        )


@dataclass(frozen=True)
class ThetaBounds(AsContract):
    """Search bounds of theta; the published bounds by default. The first angle is free over the full turn."""

    # Bounds in arXiv 2206.14444.
    detector_to_cor_mm: tuple[float, float] = field(
        default=(500.0, 1000.0), metadata=described("Lowest and highest r_D, mm.", examples=[(500.0, 1000.0)])
    )
    source_shift_mm: tuple[float, float] = field(
        default=(-500.0, 500.0), metadata=described("Lowest and highest h_S, mm.", examples=[(-500.0, 500.0)])
    )
    detector_shift_mm: tuple[float, float] = field(
        default=(-500.0, 500.0), metadata=described("Lowest and highest h_D, mm.", examples=[(-500.0, 500.0)])
    )
    detector_tilt: tuple[float, float] = field(
        default=(-1.0, 1.0),
        metadata=described("Lowest and highest alpha_D, a slope without unit.", examples=[(-1.0, 1.0)]),
    )

    def __post_init__(self) -> None:
        for name, (low, high) in vars(self).items():
            if not low < high:
                raise GeometryError(f"the bounds of {name} must be (low, high) with low < high, not ({low}, {high})")

    def contain(self, theta: Theta) -> bool:
        """Return whether theta is within the bounds; the first angle is free."""
        return all(low <= getattr(theta, name) <= high for name, (low, high) in vars(self).items())


PairCovariance = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True)
class DetectorEstimate:
    """An estimate of u_c and tau, or of a change of them."""

    cor_column_mm: float  # u_c, where the centre of rotation falls on the detector, and tau, the detector's tilt
    tilt_rad: float
    covariance: PairCovariance  # (2, 2) float: covariance of (u_c, tau), in mm and radians

    @classmethod
    def of(cls, values: Iterable[float], covariance: Iterable[Iterable[float]]) -> Self:
        """Build an estimate from numbers in the order (u_c, tau): arrays, lists or tuples."""
        try:
            column, tilt = (float(value) for value in values)
            (first, cross), (also_cross, second) = ((float(value) for value in row) for row in covariance)
        except ValueError as error:
            raise ValueError(f"u_c and tau are 2 values with a covariance of 2 x 2 values: {error}") from error
        return cls(column, tilt, ((first, cross), (also_cross, second)))

    @property
    def values(self) -> tuple[float, float]:
        """The two numbers, (u_c, tau)."""
        return self.cor_column_mm, self.tilt_rad

    @property
    def deviations(self) -> tuple[float, float]:
        """Standard deviations of (u_c, tau)."""
        (first, _), (_, second) = self.covariance
        return math.sqrt(first), math.sqrt(second)

    @property
    def relative_determinant(self) -> float:
        """Determinant of the covariance divided by the product of the variances.

        It is 1 without correlation; a covariance with 0 or less has no inverse.
        """
        (first, cross), (also_cross, second) = self.covariance
        known = all(map(math.isfinite, (*self.values, first, cross, also_cross, second)))
        return 1.0 - cross * also_cross / (first * second) if known and min(first, second) > 0.0 else 0.0
