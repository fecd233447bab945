"""The scanner's geometry: theta, the source frame, view angles, and the rays they make.

The value classes come from `sawmill_vocabulary` and are exported here for the science; this module adds the arrays.
`FanViews` is what all methods take; `FanBeamGeometry`, a scanner that turns, is one way to make it.
Axes, signs and formulas: docs/look-up/conventions.md#axes. image[i, j] has x along i and y along j, in mm, the centre
of rotation (COR) is the origin, angles count counter-clockwise.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sawmill_tomography.geometry.detector_shape import FloatArray, cell_borders_mm, cell_centres_mm, flat_borders_mm
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

# Limit of theta's lengths in mm, and for the angle and the slope: no scanner exceeds it, and double precision loses the
# rays.
LARGEST = 1e5
# Places that differ by less are the same.
SAME_MM = 1e-6


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


@dataclass(frozen=True, eq=False)
class FanViews:
    """The geometry of a scan: the rays of each view, whatever moved between them, and of each cell.

    Projector, methods of reconstruction and metal take this type. `FanBeamGeometry` makes it from theta and angles.
    """

    angles_rad: FloatArray = field(metadata={"description": "(views,). Angle of the source about the COR."})
    source_mm: FloatArray = field(metadata={"description": "(views, 2). Source of each view."})
    middle_mm: FloatArray = field(metadata={"description": "(views, 2). A point of the detector's line."})
    axis: FloatArray = field(metadata={"description": "(views, 2). Direction of the line, of length 1."})
    borders_mm: FloatArray = field(metadata={"description": "(cells, 2). Where rays to cells' borders cross the line."})

    @classmethod
    def of(cls, source_mm: ArrayLike, middle_mm: ArrayLike, axis: ArrayLike, borders_mm: ArrayLike) -> "FanViews":
        """Return the geometry of views with these vectors, each (views, 2), and cells with borders (cells, 2), mm.

        Raises
        ------
        GeometryError
            The arrays do not fit each other, are not finite, or a source lies on the line of its detector.
        """
        given = (source_mm, middle_mm, axis, borders_mm)
        source, middle, line, borders = (np.array(each, np.float64, order="C") for each in given)
        fit = source.shape == middle.shape == line.shape == (len(source), 2) and borders.shape == (len(borders), 2)
        if not fit or (np.diff(borders, axis=0) <= 0.0).any() or min(source.size, len(borders)) < 2:
            raise GeometryError("a view needs source, middle and axis (x, y), and each cell borders that increase")
        if not (np.abs(np.concatenate([source, middle, line, borders])) <= LARGEST).all():  # false for nan too
            raise GeometryError(f"the vectors of the views must be numbers of mm between {-LARGEST:g} and {LARGEST:g}")
        line /= np.hypot(*line.T)[:, None]
        views = cls(np.arctan2(source[:, 0], -source[:, 1]), source, middle, line, borders)
        behind = np.flatnonzero(~(np.prod(views.depths_mm, axis=0) > 0.0))
        if behind.size:
            raise GeometryError(f"in view {behind[0]}, from 0, the centre of rotation is not on the detector's side")
        return views

    @classmethod
    def from_astra(cls, rows: ArrayLike, cells: int) -> "FanViews":
        """Return the geometry of rows (views, 6) of ASTRA's `fanflat_vec`, in mm; the inverse of `astra_vectors`."""
        vectors = np.asarray(rows, np.float64)
        if vectors.ndim != 2 or vectors.shape[1] != 6:
            raise GeometryError(f"rows of fanflat_vec must be (views, 6) numbers, not {vectors.shape}")
        source, middle, step = (np.stack([-each[:, 1], each[:, 0]], -1) for each in np.split(vectors, 3, axis=1))
        pitch = np.hypot(*step.T)
        if np.ptp(pitch) * cells > SAME_MM:
            raise GeometryError("the cells must have the same width in all views: this list has views of two detectors")
        return cls.of(source, middle, step, (np.arange(cells)[:, None] + np.array([0.0, 1.0]) - 0.5 * cells) * pitch[0])

    @property
    def sinogram_shape(self) -> tuple[int, int]:
        """(views, cells)."""
        return self.angles_rad.size, len(self.borders_mm)

    @property
    def depths_mm(self) -> tuple[FloatArray, FloatArray]:
        """Distances of line and COR from each source along the normal, (views,); negative for cells read backwards."""
        return _cross(self.axis, self.middle_mm - self.source_mm), _cross(self.axis, -self.source_mm)

    @property
    def clear_mm(self) -> float:
        """Radius of the disc around the COR within which nothing reaches a source, along the detector's normal."""
        return float(np.abs(self.depths_mm[1]).min())

    @property
    def cell_at_cor_mm(self) -> float:
        """Width of a cell at the centre of rotation."""
        to_line, to_cor = self.depths_mm
        return float(np.median(np.diff(self.borders_mm, axis=1)) / np.mean(to_line / to_cor))

    def from_cor_mm(self, u_mm: FloatArray) -> FloatArray:
        """Return the distance from the COR at which the rays to coordinates u (n,) pass, (views, n)."""
        to = (self.middle_mm - self.source_mm)[:, None] + u_mm[:, None] * self.axis[:, None]
        return np.abs(_cross(self.source_mm[:, None], to)) / np.hypot(to[..., 0], to[..., 1])

    def vectors(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return source, detector centre and detector axis of each view, each (views, 2) in mm (axis: unit length)."""
        return self.source_mm, self.middle_mm, self.axis

    def at(self, views: slice | NDArray[np.intp] | NDArray[np.bool_]) -> "FanViews":
        """Return the geometry of some of the views."""
        source, middle, axis = (each[views] for each in self.vectors())
        return FanViews(self.angles_rad[views], source, middle, axis, self.borders_mm)

    def moved(self, shift_mm: FloatArray, roll_rad: FloatArray) -> "FanViews":
        """Return the views in the frame of an object that rolls (views,) about the COR and shifts (views, 2) in each.

        Raises
        ------
        GeometryError
            A source then lies on the line of its detector.
        """
        places = (self.source_mm - shift_mm, self.middle_mm - shift_mm, self.axis)
        source, middle, axis = (np.stack(rotate(-roll_rad, *each.T), -1) for each in places)
        return FanViews.of(source, middle, axis, self.borders_mm)

    def in_pairs(self) -> "FanViews":
        """Return the geometry with the cells, whose number is even, in pairs."""
        pairs = np.stack([self.borders_mm[::2, 0], self.borders_mm[1::2, 1]], -1)
        return FanViews(self.angles_rad, self.source_mm, self.middle_mm, self.axis, pairs)

    @property
    def uneven_mm(self) -> float:
        """Largest distance of the cells' borders from equal distances on the line."""
        even = np.linspace(self.borders_mm[0, 0], self.borders_mm[-1, 1], len(self.borders_mm) + 1)
        return float(np.abs(self.borders_mm - np.stack([even[:-1], even[1:]], -1)).max())

    def check_even(self) -> None:
        """Refuse cells that are not at equal distances on a straight line, for forms that know no others."""
        if self.uneven_mm > SAME_MM:
            raise GeometryError(
                f"the cells are up to {self.uneven_mm:.3g} mm from equal distances on a straight line, and only the "
                "form vectors holds modules and arcs: export --to vectors, or resample line integrals by export --flat"
            )

    def astra_vectors(self) -> FloatArray:
        """Return rows (srcX, srcY, dX, dY, uX, uY) of ASTRA's `fanflat_vec`, (views, 6), in mm.

        ASTRA's image has y up its rows and x along its columns, so image[i, j] with x along i is given to ASTRA
        unchanged when (x, y) is turned into (y, -x): rows run downwards in ASTRA's y.
        """
        self.check_even()
        low, high = self.borders_mm[0, 0], self.borders_mm[-1, 1]
        centre, step = self.middle_mm + 0.5 * (low + high) * self.axis, (high - low) / len(self.borders_mm) * self.axis
        return np.concatenate([np.stack([v[:, 1], -v[:, 0]], -1) for v in (self.source_mm, centre, step)], axis=1)


def turning(views: FanViews) -> "FanBeamGeometry":
    """Return the geometry as a turn about one axis; cells on an arc or of a list become cells of equal mean width.

    Raises
    ------
    GeometryError
        The views are no such turn to `SAME_MM`, or their cells count clockwise.
    """
    if isinstance(views, FanBeamGeometry) and views.scanner.detector_arc_radius_mm is None:
        return views
    angles = np.arctan2(views.source_mm[:, 0], -views.source_mm[:, 1])
    source, middle, axis = (np.stack(rotate(-angles, *each.T), -1) for each in views.vectors())
    off = max(float(np.abs(each - each[0]).max()) for each in (source, middle, 0.5 * np.ptp(views.borders_mm) * axis))
    if off > SAME_MM or views.depths_mm[0][0] < 0.0:
        raise GeometryError(
            "this needs views that turn about one axis, and cells that count counter-clockwise; these depart from a "
            f"turn by {off:.3g} mm: reconstruct them by total_variation, cauchy_map or tikhonov"
        )
    r, (x, y), (c, s) = -float(source[0, 1]), middle[0], axis[0]
    borders = views.borders_mm - 0.5 * (views.borders_mm[0, 0] + views.borders_mm[-1, 1])
    u_c = -x / c + float(borders[0, 0] - views.borders_mm[0, 0])
    scanner = Scanner(r, len(borders), float(np.ptp(borders)) / len(borders))
    frame = SourceFrame(0.0, r, r + float(y - x * s / c), float(u_c), math.atan2(s, c))
    return FanBeamGeometry(scanner, frame.theta(r), angles, borders)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


@dataclass(frozen=True, eq=False, init=False)
class FanBeamGeometry(FanViews):
    """A fan-beam geometry that turns about one axis: one source, one line detector, explicit view angles.

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

    def __init__(
        self, scanner: Scanner, theta: Theta, angles_rad: ArrayLike, borders_mm: FloatArray | None = None
    ) -> None:
        """Make the views; refuse angles that are not a list of finite numbers, and a theta that no scanner has.

        `borders_mm` (cells, 2): the cells' borders on the line; None: by the shape of the scanner's detector.
        """
        angles = np.ascontiguousarray(angles_rad, dtype=np.float64)
        if angles.ndim != 1 or angles.size == 0 or not np.isfinite(angles).all():
            raise GeometryError("angles_rad must be one finite number of radians for each view")
        for name, value in vars(theta).items():
            if not abs(value) <= LARGEST:  # true for nan too
                raise GeometryError(f"{name} must lie between {-LARGEST:g} and {LARGEST:g}, not {value:.6g}")
        if borders_mm is None:
            borders_mm = flat_borders_mm(scanner, theta.source_frame(scanner.source_to_cor_mm))
        phi = angles + theta.initial_angle_rad
        source = rotate(phi, theta.source_shift_mm, -scanner.source_to_cor_mm)
        middle = rotate(phi, -theta.detector_shift_mm, theta.detector_to_cor_mm)
        axis = rotate(phi, *(np.array([1.0, theta.detector_tilt]) / math.hypot(1.0, theta.detector_tilt)))
        super().__init__(angles, np.stack(source, -1), np.stack(middle, -1), np.stack(axis, -1), borders_mm)
        vars(self).update(scanner=scanner, theta=theta)

    @property
    def frame(self) -> SourceFrame:
        """The source frame of theta."""
        return self.theta.source_frame(self.scanner.source_to_cor_mm)

    def at(self, views: slice | NDArray[np.intp] | NDArray[np.bool_]) -> "FanBeamGeometry":
        """Return the geometry of some of the views."""
        return self.with_angles(self.angles_rad[views])

    def with_angles(self, angles_rad: FloatArray) -> "FanBeamGeometry":
        """Return the geometry of the same scanner at other view angles."""
        return FanBeamGeometry(self.scanner, self.theta, angles_rad, self.borders_mm)


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


def turns_all_round(geometry: FanViews) -> bool:
    """Return whether the views turn about one axis over a full turn, as filtered back-projection needs them."""
    try:
        view_weights(turning(geometry).angles_rad)
    except GeometryError:
        return False
    return True
