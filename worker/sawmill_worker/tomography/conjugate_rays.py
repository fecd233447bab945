"""Conjugate rays: over a full turn every ray is measured twice, once from either side.

P(theta + gamma, u(gamma)) = P(theta + pi - gamma, u(-gamma)) with u(gamma) = u_c + SDD sin gamma / cos(gamma + tau):
there is no R in it, so u_c, tau and SDD can be fitted to any dense full-turn scan (docs/geometry.md#drift; the symmetry
is that of Kak and Slaney 1988, section 3.4.3). R and psi cannot be seen.
"""

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, rfft
from scipy.interpolate import CubicSpline
from scipy.linalg import eigh
from scipy.sparse import csr_array

from sawmill_worker.tomography.calibration.faults.screening import screen
from sawmill_worker.tomography.drift import DECISIVE_RATIO, ConjugateFit, DriftError
from sawmill_worker.tomography.geometry import TAU, FloatArray, Scanner, SourceFrame, cell_centres_mm
from sawmill_worker.tomography.view_gain import view_gain
from sawmill_worker.vocabulary import Rotation

ComplexArray = NDArray[np.complex128]

# Between views farther apart than this the sinogram of a log is not sampled well enough for its rays to be paired.
WIDEST_STEP_DEG = 3.0
# Share by which an encoder may scatter a step.
JITTER = 0.02
# Blur in views and in cells: the coarse one finds the basin and the sense of rotation, the finest one that the noise
# allows finds the minimum.
COARSE = (4.0, 8.0)
FINE = ((1.0, 1.5), (1.5, 2.5), (2.0, 4.0), (3.0, 6.0))
# Gaussians are cut off here, in widths.
CUT_OFF = 4.5
# Pairs stand this many widths of the blur apart, but not closer than cells.
PAIR_STEP = 0.5
# How far u_c (share of the detector), tau (rad) and SDD (share) may have moved and are still followed.
REACH = (0.05, 0.2, 0.2)
# Below this share of signal in the slopes, in the worst direction, the stated errors are too small (a fifth at 0.2).
SIGNAL_SHARE = 0.3
# An SDD less certain than this share of itself is not seen: it is held at the calibrated one.
WORST_DISTANCE = 0.02
# A u_c less certain than this share of a cell says nothing about drift.
WORST_CELLS = 0.5
# Nor does a tau less certain than this (rad): along so flat a basin the errors are no longer those of a linear fit.
WORST_TILT = 0.03
STEPS = 40
# A step below this share of the standard deviations is the last one.
SMALL_STEP = 1e-2
# A view whose rays differ from their opposites this many times more than the views' median does not belong to the turn;
# where more than this share of the views would not, it is the log that moved. Its opposites differ too: only those near
# the worst are left out at a time.
ODD_VIEW, MOST_ODD_VIEWS, NEAR_WORST = 3.0, 0.1, 0.7
# A pair is left out when a ray of it lies within this many widths of the blur of a cell without data, unless that would
# be more than this share of the pairs.
CELL_REACH, MOST_TOUCHED = 3.0, 0.5
# A gain found with a wrong geometry hides part of the error: so often are both found in turn.
GAIN_ROUNDS = 3
# Which of (u_c, tau, SDD) are fitted.
ALL_THREE, WITHOUT_DISTANCE = slice(0, 3), slice(0, 2)


@dataclass(frozen=True, eq=False)
class _Turn:
    """A full turn in the Fourier domain of equidistant views.

    Attributes
    ----------
    spectrum : (cells, harmonics) complex128
        From the first harmonic up to below Nyquist's.
    views : int
    filled_rad : (views left out,) float64
        Angles at which there are no data, only what their neighbours suggest.
    bridged : (cells,) bool
        Cells without data of their own, likewise.
    """

    spectrum: ComplexArray
    views: int
    filled_rad: FloatArray
    bridged: NDArray[np.bool_]

    def read(self, rotation: Rotation) -> "_Turn":
        """As this sense of rotation reads the angles: phi -> -phi is the conjugate of every harmonic."""
        if rotation is Rotation.AS_GIVEN:
            return self
        return replace(self, spectrum=self.spectrum.conj(), filled_rad=-self.filled_rad)


@dataclass(frozen=True, eq=False)
class _PairedRays:
    """Differences of opposite rays (pairs, theta), and their derivatives by (u_c, tau, SDD), (3, pairs, theta).

    Attributes
    ----------
    difference, slopes : float64
        Not blurred over theta, where white noise of the views is white.
    instruments : float64
        The slopes blurred twice over theta: the score is that of least squares of blurred differences.
    noise_slopes, noise_instruments : float64
        The same of half the differences, which carry as much noise as half the sums and no signal.
    used : bool
        Pairs of which both rays were measured.
    relative_residual : float
        RMS of the blurred differences against that of the blurred rays.
    """

    difference: FloatArray
    slopes: FloatArray
    instruments: FloatArray
    noise_slopes: FloatArray
    noise_instruments: FloatArray
    used: NDArray[np.bool_]
    relative_residual: float

    def scores(self) -> FloatArray:
        """Instruments times differences at each theta, (theta, 3)."""
        scores: FloatArray = np.einsum("xpt,pt->tx", self.instruments, self.difference)
        return scores

    def gram(self, *, corrected: bool) -> FloatArray:
        """(3, 3) of instruments and slopes.

        Both are those of noisy data, and their noise makes the matrix too large (errors in variables); the noise's
        share, as half the differences have it, can be taken off.
        """
        gram = _products(self.instruments, self.slopes)
        return gram - _products(self.noise_instruments, self.noise_slopes) if corrected else gram

    def covariance(self, free: slice, *, corrected: bool) -> FloatArray:
        """Heteroscedasticity-robust covariance (White 1980) of the free unknowns, from each theta's score.

        Infinite where the pairs do not show them.
        """
        gram, noisy = (self.gram(corrected=kind)[free, free] for kind in (corrected, False))
        if not (_is_definite(noisy) and _signal_share(gram, noisy) > SIGNAL_SHARE):
            return np.full(gram.shape, math.inf)
        scores = self.scores()[:, free]
        bread = np.linalg.inv(gram)
        covariance: FloatArray = bread @ (scores.T @ scores) @ bread.T
        return covariance


def _fan(scanner: Scanner, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Each cell's fan angle (cells,) and the angle that the cell covers."""
    u_c, tau, sdd = vector
    w = cell_centres_mm(scanner) - u_c
    across, along = w * math.cos(tau), sdd + w * math.sin(tau)
    return np.arctan2(across, along), sdd * math.cos(tau) * scanner.detector_pitch_mm / (across**2 + along**2)


def _products(left: FloatArray, right: FloatArray) -> FloatArray:
    return left.reshape(3, -1) @ right.reshape(3, -1).T


class _Pairs:
    """Paired rays as a function of (u_c, tau, SDD).

    In the Fourier domain of the views the turn by gamma is an exact phase, so views are never interpolated. The blur
    over cells is even in gamma at fixed theta, so both rays of a pair are blurred alike. The constant harmonic is left
    out: what every view has in common (errors of the flat field, rings, a background) cannot pass for drift.
    """

    def __init__(self, scanner: Scanner, turn: _Turn, start: FloatArray, blur: tuple[float, float]) -> None:
        self._scanner, self._turn = scanner, turn
        self._orders = np.arange(1, turn.spectrum.shape[1] + 1)
        self._blur = np.exp(-0.5 * (blur[0] * self._orders * TAU / turn.views) ** 2)
        fan, _ = _fan(self._scanner, start)
        spacing = float(np.median(np.diff(fan)))
        self._width = blur[1] * spacing
        self._taps = np.arange(-math.ceil(1.1 * CUT_OFF * blur[1]), math.ceil(1.1 * CUT_OFF * blur[1]) + 1)
        step = max(1.0, PAIR_STEP * blur[1]) * spacing
        pairs = int((min(-fan[0], fan[-1]) - 4.0 * self._width) / step)
        if pairs < 8:
            raise DriftError(
                "outside-detector",
                f"the centre of rotation falls on u = {start[0]:.4g} mm, at the detector's edge or beyond: "
                "opposite rays need detector on both sides of it",
            )
        self.gamma = (np.arange(pairs) + 0.5) * step
        self._used = self._measured(fan)

    def views_of(self) -> tuple[FloatArray, FloatArray]:
        """Angle of the view that measured each ray, and each opposite ray, (pairs, theta)."""
        theta = np.arange(self._turn.views) * TAU / self._turn.views
        return theta + self.gamma[:, None], theta + math.pi - self.gamma[:, None]

    def _measured(self, fan: FloatArray) -> NDArray[np.bool_]:
        """Pairs without a ray next to a view or a cell that was left out; cells stay in where they are too many."""
        step = TAU / self._turn.views
        used = np.ones((self.gamma.size, self._turn.views), bool)
        for angles in self.views_of() if self._turn.filled_rad.size else ():
            for filled in self._turn.filled_rad:
                used &= np.abs(np.remainder(angles - filled + math.pi, TAU) - math.pi) > step
        missing = np.abs(fan[self._turn.bridged])
        touched = (np.abs(self.gamma[:, None] - missing) < CELL_REACH * self._width).any(axis=1)
        if touched.mean() < MOST_TOUCHED:
            used[touched] = False
        return used

    def at(self, vector: FloatArray) -> _PairedRays:
        """The pairs with this geometry."""
        fan, covered = _fan(self._scanner, vector)
        turned = self._turn.spectrum * np.exp(1j * np.outer(fan, self._orders)) * covered[:, None]
        rays, slope = self._side(turned, fan, 1.0)
        opposite, opposite_slope = self._side(turned, fan, -1.0)
        half_turn = np.where(self._orders % 2, -1.0, 1.0)
        opposite, opposite_slope = half_turn * opposite, -half_turn * opposite_slope
        half_sum, difference = 0.5 * (rays + opposite), rays - opposite
        shifts = _shifts(vector, self.gamma), _shifts(vector, -self.gamma)
        slopes = self._slopes(half_sum, 0.5 * (slope + opposite_slope), *shifts)
        noise_slopes = self._slopes(0.5 * difference, 0.5 * (slope - opposite_slope), *shifts)
        twice = self._blur**2
        blurred = (self._over_theta(rays * self._blur) * self._used for rays in (difference, half_sum))
        residual, signal = (float(np.sum(rays**2)) for rays in blurred)
        return _PairedRays(
            self._over_theta(difference),
            self._over_theta(slopes),
            self._over_theta(slopes * twice) * self._used,
            self._over_theta(noise_slopes),
            self._over_theta(noise_slopes * twice) * self._used,
            self._used,
            math.sqrt(residual / signal),
        )

    def _over_theta(self, harmonics: ComplexArray) -> FloatArray:
        """(..., harmonics) as (..., views) over theta."""
        spectrum = np.zeros((*harmonics.shape[:-1], self._turn.views // 2 + 1), np.complex128)
        spectrum[..., 1 : self._orders.size + 1] = harmonics
        values: FloatArray = irfft(spectrum, self._turn.views, axis=-1, overwrite_x=True)
        return values

    def _side(self, turned: ComplexArray, fan: FloatArray, side: float) -> tuple[ComplexArray, ComplexArray]:
        """P(theta + gamma, u(gamma)) at plus or minus the pairs' gamma, and its derivative by gamma at fixed theta."""
        gamma = side * self.gamma[:, None]
        near = np.searchsorted(fan, gamma) + self._taps
        inside = (near >= 0) & (near < fan.size)
        near = near.clip(0, fan.size - 1)
        z = (gamma - fan[near]) / self._width
        kernel = np.exp(-0.5 * z * z) / (math.sqrt(TAU) * self._width) * inside
        borders = np.arange(gamma.size + 1) * self._taps.size
        real = turned.view(np.float64)
        smoothed, slope = (
            csr_array((values.ravel(), near.ravel(), borders), shape=(gamma.size, fan.size)) @ real
            for values in (kernel, -z / self._width * kernel)
        )
        return smoothed.view(np.complex128), slope.view(np.complex128)

    def _slopes(
        self, rays: ComplexArray, by_gamma: ComplexArray, near: FloatArray, opposite: FloatArray
    ) -> ComplexArray:
        """Derivatives of the differences by (u_c, tau, SDD) where both rays of each pair are these, (3, ...).

        A ray's derivative by gamma at fixed view is that at fixed theta less that by theta; the opposite ray has the
        first with its sign turned and the second as it is.
        """
        by_theta = 1j * self._orders * rays
        return (near + opposite)[:, :, None] * by_gamma + (opposite - near)[:, :, None] * by_theta

    def solve(
        self, start: FloatArray, low: FloatArray, high: FloatArray, *, free: slice, corrected: bool
    ) -> "_Solution":
        """Gauss-Newton in the free unknowns from the start, inside the reach."""
        vector, rays = start, self.at(start)
        for _ in range(STEPS):
            gram = rays.gram(corrected=corrected)[free, free]
            if not _is_definite(gram):
                break
            moved = vector.copy()
            moved[free] -= np.linalg.solve(gram, rays.scores().sum(axis=0)[free])
            moved = np.clip(moved, low, high)
            spread = np.sqrt(np.diag(rays.covariance(free, corrected=corrected)))
            small = np.all(np.abs(moved - vector)[free] <= SMALL_STEP * spread)
            vector, rays = moved, self.at(moved)
            if small:
                settled = bool(np.all((vector > low) & (vector < high)))
                return _Solution(vector, settled, self, rays, rays.covariance(free, corrected=corrected), free)
        unknown = np.full_like(gram, math.inf)
        return _Solution(vector, False, self, rays, unknown, free)  # noqa: FBT003 - a field, named in the class


@dataclass(frozen=True, eq=False)
class _Solution:
    """(u_c, tau, SDD) at the end of a fit, whether it came to rest inside the reach, pairs and covariance there."""

    vector: FloatArray
    settled: bool
    pairs: _Pairs
    rays: _PairedRays
    free_covariance: FloatArray
    free: slice

    @property
    def covariance(self) -> FloatArray:
        """Of all three; what is not free has zeros."""
        covariance = np.zeros((3, 3))
        covariance[self.free, self.free] = self.free_covariance
        return covariance

    @property
    def distance_sensitivity(self) -> FloatArray:
        """Change of (u_c, tau) per mm of the SDD at which they were fitted, (2,); zeros where it is free."""
        if self.free == ALL_THREE:
            return np.zeros(2)
        gram = self.rays.gram(corrected=True)
        return np.asarray(-np.linalg.solve(gram[:2, :2], gram[:2, 2]), np.float64)


def _shifts(vector: FloatArray, gamma: NDArray[np.floating]) -> FloatArray:
    """Angles by which a ray at gamma turns per unit of (u_c, tau, SDD): du/dx over du/dgamma, (3, rays)."""
    _, tau, sdd = vector
    c = np.cos(gamma + tau)
    by = np.stack([np.ones_like(gamma), sdd * np.sin(gamma) * np.sin(gamma + tau) / c**2, np.sin(gamma) / c])
    shifts: FloatArray = by * (c * c / (sdd * math.cos(tau)))
    return shifts


def _is_definite(gram: FloatArray) -> bool:
    diagonal = np.diag(gram)
    if not np.all(diagonal > 0.0):
        return False
    scale = 1.0 / np.sqrt(diagonal)
    return bool(np.linalg.eigvalsh(gram * np.outer(scale, scale))[0] > 1e-6)


def _signal_share(gram: FloatArray, noisy: FloatArray) -> float:
    """The smallest share that is left of the noisy matrix in any direction; a mask makes them a little asymmetric."""
    return float(eigh(gram + gram.T, noisy + noisy.T, eigvals_only=True)[0])


def _even_views(sinogram: FloatArray, angles_rad: FloatArray, usable: NDArray[np.bool_]) -> tuple[FloatArray, float]:
    """The sinogram at equidistant angles, as many as views, by periodic cubic splines through the usable ones.

    Returns it, (views, cells), and the first of the angles.
    """
    wrapped = np.mod(angles_rad, TAU)
    first = float(wrapped.min())
    order = np.flatnonzero(usable)[np.argsort(wrapped[usable], kind="stable")]
    knots = np.append(wrapped[order], wrapped[order[0]] + TAU)
    values = np.concatenate([sinogram[order], sinogram[order[:1]]])
    wanted = first + np.arange(angles_rad.size) * TAU / angles_rad.size
    spline = CubicSpline(knots, values, bc_type="periodic", extrapolate="periodic")
    return np.asarray(spline(wanted), np.float64), first


def _turn(even: FloatArray, first_rad: float, filled_rad: FloatArray, bridged: NDArray[np.bool_]) -> _Turn:
    views = len(even)
    spectrum = rfft(np.ascontiguousarray(even.T), axis=-1)[:, 1 : (views + 1) // 2]
    orders = np.arange(1, spectrum.shape[1] + 1)
    return _Turn(np.ascontiguousarray(spectrum * np.exp(-1j * orders * first_rad)), views, filled_rad, bridged)


def conjugate_fit(
    scanner: Scanner,
    sinogram: FloatArray,
    angles_rad: FloatArray,
    start: SourceFrame,
    rotation: Rotation = Rotation.AS_GIVEN,
) -> ConjugateFit:
    """Fit u_c, tau and SDD to the pairs of opposite rays of any object, in both senses of rotation.

    Parameters
    ----------
    sinogram : (views, detector) float
        Line integrals of anything that turned as one body, all round.
    angles_rad : (views,) float64
        As the scan gives them.
    start : SourceFrame
        The calibrated geometry.
    rotation : Rotation
        The calibrated sense; it is kept where the scan does not tell the two apart.

    Raises
    ------
    DriftError
        If the views are sparse or do not go all round, or the scan does not show the three.
    """
    sinogram, angles_rad = np.asarray(sinogram, np.float64), np.asarray(angles_rad, np.float64)
    _check(sinogram, angles_rad)
    screening = screen(sinogram)
    scan = _Scan(
        scanner, screening.bridged(sinogram), angles_rad, screening.views, ~screening.cells, screening.adjustments
    )
    best, rotation, ratio, used = _fit(scan, start, rotation)
    while (odd := _odd_views(scan, best, rotation)).any():
        scan = replace(scan, usable=scan.usable & ~odd)
        best, rotation, ratio, used = _fit(scan, start, rotation)
    disagreeing = int(np.sum(screening.views & ~scan.usable))
    remark = f"{disagreeing} views whose rays do not agree with their opposites were left out"
    _check_found(scanner, best, start)
    u_c, tau, sdd = (float(value) for value in best.vector)
    return ConjugateFit(
        u_c,
        tau,
        sdd,
        best.covariance,
        best.free == WITHOUT_DISTANCE,
        rotation,
        ratio,
        best.rays.relative_residual,
        best.distance_sensitivity,
        (*used.done, remark) if disagreeing else used.done,
    )


@dataclass(frozen=True, eq=False)
class _Scan:
    """What is fitted, the views that are used, the cells that are not, and what was done to it."""

    scanner: Scanner
    sinogram: FloatArray
    angles_rad: FloatArray
    usable: NDArray[np.bool_]
    bridged: NDArray[np.bool_]
    done: tuple[str, ...]


def _fit(scan: _Scan, start: SourceFrame, rotation: Rotation) -> tuple[_Solution, Rotation, float, _Scan]:
    """The fit in the better sense of rotation, how much better it is, and the scan with what was done to it."""
    even, first = _even_views(scan.sinogram, scan.angles_rad, scan.usable)
    filled = scan.angles_rad[~scan.usable]
    turn = _turn(even, first, filled, scan.bridged)
    other = next(sense for sense in Rotation if sense is not rotation)
    basins = {sense: _basin(scan.scanner, turn.read(sense), start) for sense in (rotation, other)}
    ratio = basins[other].rays.relative_residual / basins[rotation].rays.relative_residual
    if ratio < 1.0 / DECISIVE_RATIO:
        rotation, ratio = other, 1.0 / ratio
    vector, done = basins[rotation].vector, scan.done
    for _ in range(GAIN_ROUNDS):
        fan, _ = _fan(scan.scanner, vector)
        gain = view_gain(even, fan, reversed_turn=rotation is Rotation.REVERSED)
        if gain is not None:
            turn = _turn(gain.removed(even), first, filled, scan.bridged)
            done = (*scan.done, gain.done)
        best = _minimum(scan.scanner, turn.read(rotation), start, vector)
        if gain is None or not best.settled:
            break
        vector = best.vector
    return best, rotation, ratio, replace(scan, done=done)


def _odd_views(scan: _Scan, best: _Solution, rotation: Rotation) -> NDArray[np.bool_]:
    """Views (views,) whose rays differ from their opposites far more than the others' do."""
    views = scan.angles_rad.size
    squares = np.where(best.rays.used, best.rays.difference**2, 0.0).ravel()
    sums, counts = np.zeros(views), np.zeros(views)
    for angles in best.pairs.views_of():
        nearest = np.rint((angles - scan.angles_rad.min()) * views / TAU).astype(np.intp).ravel() % views
        sums += np.bincount(nearest, squares, views)
        counts += np.bincount(nearest, best.rays.used.ravel(), views)
    rms = np.sqrt(sums / np.maximum(counts, 1.0))
    at = np.rint((rotation.apply(scan.angles_rad) - scan.angles_rad.min()) * views / TAU).astype(np.intp) % views
    odd: NDArray[np.bool_] = (
        scan.usable & (rms > max(ODD_VIEW * float(np.median(rms)), NEAR_WORST * float(rms.max())))[at]
    )
    return odd if np.sum(odd | ~scan.usable) <= MOST_ODD_VIEWS * views else np.zeros(views, bool)


def _reach(scanner: Scanner, start: SourceFrame) -> tuple[FloatArray, FloatArray]:
    centre = _vector(start)
    width = scanner.num_detector_pixels * scanner.detector_pitch_mm
    reach = np.array(REACH) * [width, 1.0, start.source_to_detector_mm]
    return centre - reach, centre + reach


def _vector(frame: SourceFrame) -> FloatArray:
    return np.array([frame.cor_column_mm, frame.tilt_rad, frame.source_to_detector_mm])


def _basin(scanner: Scanner, turn: _Turn, start: SourceFrame) -> _Solution:
    """The coarse fit, with SDD held: it needs the fine structure of the log."""
    pairs = _Pairs(scanner, turn, _vector(start), COARSE)
    return pairs.solve(_vector(start), *_reach(scanner, start), free=WITHOUT_DISTANCE, corrected=False)


def _minimum(scanner: Scanner, turn: _Turn, start: SourceFrame, basin: FloatArray) -> _Solution:
    """The fit from the coarse one's end: as fine, and with as many unknowns, as the scan allows."""
    worst = (WORST_CELLS * scanner.detector_pitch_mm, WORST_TILT, WORST_DISTANCE * start.source_to_detector_mm)
    for free, blur in product((ALL_THREE, WITHOUT_DISTANCE), FINE):
        pairs = _Pairs(scanner, turn, basin, blur)
        solution = pairs.solve(basin, *_reach(scanner, start), free=free, corrected=True)
        if solution.settled and np.all(np.sqrt(np.diag(solution.covariance)) < worst):
            break
    return solution


def _check_found(scanner: Scanner, solution: _Solution, start: SourceFrame) -> None:
    certain = WORST_CELLS * scanner.detector_pitch_mm
    if not (solution.covariance[0, 0] < certain**2 and solution.covariance[1, 1] < WORST_TILT**2):
        raise DriftError(
            "nothing-seen",
            f"opposite rays do not place the centre of rotation on the detector to {certain:.3g} mm and the tilt to "
            f"{math.degrees(WORST_TILT):.2g} degrees: average more rows, scan a log that is less round or less "
            "centred, or calibrate with the phantom",
        )
    if not solution.settled:
        raise DriftError(
            "moved-too-far",
            f"no geometry near the calibrated one (u_c {start.cor_column_mm:.4g} mm) makes opposite rays agree: the "
            "log moved while it was scanned, the calibration is another scanner's, or the geometry moved by more than "
            f"{REACH[0]:.0%} of the detector; calibrate with the phantom",
        )


def _check(sinogram: FloatArray, angles_rad: FloatArray) -> None:
    wrapped = np.sort(np.mod(angles_rad, TAU))
    gaps = np.rad2deg(np.diff(wrapped, append=wrapped[0] + TAU))
    widest, usual = float(gaps.max()), float(np.median(gaps))
    allowed = WIDEST_STEP_DEG * (1.0 + JITTER)
    if widest > allowed >= usual:
        raise DriftError(
            "partial-turn",
            f"the views leave a gap of {widest:.3g} degrees where their usual distance is {usual:.3g}: opposite rays "
            f"can be paired only all round the full turn, in steps of {WIDEST_STEP_DEG:g} degrees or less",
        )
    if widest > allowed:
        raise DriftError(
            "sparse-views",
            f"the {angles_rad.size} views stand {usual:.3g} degrees apart: opposite rays can be paired only in steps "
            f"of {WIDEST_STEP_DEG:g} degrees or less; calibrate with the phantom instead",
        )
    if np.ptp(sinogram, axis=0).max() == 0.0:
        raise DriftError("nothing-seen", "every view of the sinogram is the same: scan a log while it turns")
