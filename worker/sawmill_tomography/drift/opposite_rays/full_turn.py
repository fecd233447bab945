"""A full turn of views: a check that its steps are small enough, and its rays over every angle.

chi is the direction of a ray in the plane, as the angle of a parallel beam (docs/understand/drift.md#dense-scans).
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.drift.change import DriftError
from sawmill_tomography.geometry.geometry import TAU, FloatArray
from sawmill_vocabulary import WIDEST_MEASURED_STEP_DEG, WIDEST_STEP_DEG, Rotation

ComplexArray = NDArray[np.complex128]
# Views nearer than this share of an even step count as views at one angle, like 0 and 360 degrees: a curve through both
# would swing by their noise.
SAME_PLACE = 0.1
# Views nearer than this share to even steps are not interpolated.
SAME_ANGLE = 1e-6


@dataclass(frozen=True, eq=False)
class FullTurn:
    """A full turn in the Fourier domain of equidistant views."""

    spectrum: ComplexArray  # (cells, views // 2 + 1) complex128
    mean: FloatArray  # (cells,): the constant harmonic
    views: int
    filled_rad: FloatArray  # (views left out,): angles without data, filled from their neighbours
    bridged: NDArray[np.bool_]  # (cells,) bool: cells without data, filled likewise
    left_out: NDArray[np.bool_]  # (views, cells) bool
    first_rad: float
    sense: int = 1  # -1 where the angles are read in the opposite sense to `left_out`

    @classmethod
    def of(
        cls,
        even: FloatArray,
        first_rad: float,
        angles_rad: FloatArray,
        *,
        usable: NDArray[np.bool_],
        bridged: NDArray[np.bool_],
        left_out: NDArray[np.bool_],
    ) -> "FullTurn":
        """Return the turn of `even_views`; views, cells and samples (views, cells) left out keep the scan order."""
        views = len(even)
        phases = np.exp(-1j * first_rad * np.arange(views // 2 + 1))
        missing = np.zeros(even.shape, bool)
        missing[nearest_view(angles_rad, first_rad, views)] = left_out
        return cls(
            _of_inner_orders(scipy.fft.rfft(even.T) * phases, views),
            even.mean(axis=0),
            views,
            angles_rad[~usable],
            bridged,
            missing,
            first_rad,
        )

    def read(self, rotation: Rotation) -> "FullTurn":
        """Return the turn in a sense of rotation: phi -> -phi is the conjugate of every harmonic."""
        if rotation is Rotation.AS_GIVEN:
            return self
        return replace(self, spectrum=self.spectrum.conj(), filled_rad=-self.filled_rad, sense=-self.sense)

    def of_fewer_views(self, views: int) -> "FullTurn":
        """Return the turn with the harmonics that this number of equidistant views has."""
        if views >= self.views:
            return self
        kept = (np.arange(views) * self.views / views).round().astype(int)
        return replace(
            self,
            spectrum=_of_inner_orders(self.spectrum[:, : views // 2 + 1] * (views / self.views), views),
            views=views,
            left_out=self.left_out[kept],
        )

    def nearest_view(self, angles_rad: FloatArray) -> NDArray[np.intp]:
        """Return the row of `left_out` for each angle in the turn's sense."""
        return nearest_view(self.sense * angles_rad, self.first_rad, self.views)


def _of_inner_orders(spectrum: ComplexArray, views: int) -> ComplexArray:
    """Set the constant harmonic and the one of Nyquist's frequency to 0, in place."""
    spectrum[:, 0] = spectrum[:, (views + 1) // 2 :] = 0.0
    return spectrum


def nearest_view(angles_rad: FloatArray, first_rad: float, views: int) -> NDArray[np.intp]:
    """Return, for each angle, the index of the nearest of equidistant views, of which the first is at `first_rad`."""
    return np.rint((angles_rad - first_rad) * views / TAU).astype(np.intp) % views


def even_views(sinogram: FloatArray, angles_rad: FloatArray, usable: NDArray[np.bool_]) -> tuple[FloatArray, float]:
    """Interpolate the sinogram at equidistant angles, as many as views, by periodic cubic splines of the usable views.

    Views at one angle count by their mean. Returns the sinogram, (views, cells), and the first of the angles.
    """
    wrapped = np.mod(angles_rad, TAU)
    first = float(wrapped.min())
    even_angles = first + np.arange(angles_rad.size) * TAU / angles_rad.size
    order = np.flatnonzero(usable)[np.argsort(wrapped[usable], kind="stable")]
    if usable.all() and np.abs(wrapped[order] - even_angles).max() < SAME_ANGLE * TAU / angles_rad.size:
        return sinogram[order], first
    # The widest gap is at the seam, so that the seam separates no views at one angle.
    order = np.roll(order, -1 - int(np.argmax(np.diff(wrapped[order], append=wrapped[order[0]] + TAU))))
    unwrapped = wrapped[order[0]] + np.mod(wrapped[order] - wrapped[order[0]], TAU)
    places = np.flatnonzero(np.diff(unwrapped, prepend=-math.inf) > SAME_PLACE * TAU / angles_rad.size)
    members = np.diff(places, append=order.size)
    knots = np.add.reduceat(unwrapped, places) / members
    return periodic_spline(knots, np.add.reduceat(sinogram[order], places) / members[:, None], even_angles), first


def periodic_spline(knots_rad: FloatArray, values: FloatArray, angles_rad: FloatArray) -> FloatArray:
    """Evaluate the cubic splines of period 2 pi through values at angles.

    Press et al., Numerical Recipes, 3rd edition, equations 3.3.2 to 3.3.7, the last with cyclic neighbours, and 2.7.5.
    SciPy's spline is equal and no faster; its module takes longer to import than a job of 20 views to calibrate.

    `knots_rad` (knots,): at least two, rising, within one turn. `values` (knots, columns). `angles_rad` (angles,).
    Returns (angles, columns).
    """
    after = np.roll(np.arange(knots_rad.size), -1)
    steps = np.diff(knots_rad, append=knots_rad[0] + TAU)[:, None]
    slopes = (values[after] - values) / steps
    # The last knot's link to the first is not in the band; the Sherman-Morrison formula adds it.
    link, ends = steps[-1], np.zeros_like(steps)
    ends[[0, -1]] = 1.0
    band = np.hstack([np.roll(steps, 1), 2.0 * (steps + np.roll(steps, 1)) - link * ends]).T
    unlinked = scipy.linalg.solveh_banded(band, np.hstack([6.0 * (slopes - np.roll(slopes, 1, axis=0)), ends]))
    curvatures, of_ends = unlinked[:, :-1], unlinked[:, -1:]
    curvatures -= of_ends * link * (curvatures[0] + curvatures[-1]) / (1.0 + link * (of_ends[0] + of_ends[-1]))
    wrapped = knots_rad[0] + np.mod(angles_rad - knots_rad[0], TAU)
    left = np.searchsorted(knots_rad, wrapped, side="right") - 1
    right, step = after[left], steps[left]
    b = (wrapped - knots_rad[left])[:, None] / step
    a = 1.0 - b
    bent = (a**3 - a) * curvatures[left] + (b**3 - b) * curvatures[right]
    return np.asarray(a * values[left] + b * values[right] + bent * step**2 / 6.0, np.float64)


def widest_gap_rad(angles_rad: FloatArray) -> float:
    """Return the widest gap between views of a turn, rad."""
    return math.radians(float(_gaps_deg(angles_rad).max()))


def opposite_rays_pair(angles_rad: FloatArray) -> bool:
    """Return whether the views cover a full turn in steps so small that every ray has its opposite."""
    return float(_gaps_deg(angles_rad).max()) <= WIDEST_MEASURED_STEP_DEG


def check_full_turn(sinogram: FloatArray, angles_rad: FloatArray) -> None:
    """Refuse views that do not cover a full turn in small steps, and views that are all the same, as a `DriftError`."""
    gaps = _gaps_deg(angles_rad)
    widest, usual = float(gaps.max()), float(np.median(gaps))
    if widest > WIDEST_MEASURED_STEP_DEG >= usual:
        raise DriftError(
            "partial-turn",
            f"the views leave a gap of {widest:.3g} degrees where their usual distance is {usual:.3g}: opposite rays "
            f"can be paired only all round the full turn, in steps of {WIDEST_STEP_DEG:g} degrees or less",
        )
    if widest > WIDEST_MEASURED_STEP_DEG:
        raise DriftError(
            "sparse-views",
            f"the {angles_rad.size} views stand {usual:.3g} degrees apart: opposite rays can be paired only in steps "
            f"of {WIDEST_STEP_DEG:g} degrees or less; calibrate with the phantom instead",
        )
    if np.ptp(sinogram, axis=0).max() == 0.0:
        raise DriftError("nothing-seen", "every view of the sinogram is the same: scan a log while it turns")


def _gaps_deg(angles_rad: FloatArray) -> FloatArray:
    wrapped = np.sort(np.mod(angles_rad, TAU))
    return np.rad2deg(np.diff(wrapped, append=wrapped[0] + TAU))
