"""Conjugate rays: over a full turn every ray is measured twice, once from either side.

P(theta + gamma, u(gamma)) = P(theta + pi - gamma, u(-gamma)) with u(gamma) = u_c + SDD sin gamma / cos(gamma + tau):
there is no R in it, so u_c, tau and SDD can be fitted to any dense full-turn scan (design page, section 5; the symmetry
is that of Kak and Slaney 1988, section 3.4.3). R and psi cannot be seen.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.linalg import eigh

from worker.tomography.drift import DECISIVE_RATIO, ConjugateFit, DriftError
from worker.tomography.geometry import TAU, FloatArray, Rotation, Scanner, SourceFrame

ComplexArray = NDArray[np.complex128]

# Between views farther apart than this the sinogram of a log is not sampled well enough for its rays to be paired.
WIDEST_STEP_DEG = 3.0
# Share by which an encoder may scatter a step.
JITTER = 0.02
# Blur in views and in cells: the coarse one finds the valley and the sense of rotation, the fine one the bottom.
COARSE, FINE = (4.0, 8.0), (1.0, 1.5)
# Neighbouring views share errors: scores are summed over so many blocks of the turn, less one for each unknown.
BLOCKS = 24
# How far u_c (share of the detector), tau (rad) and SDD (share) may have moved and are still followed.
REACH = (0.05, 0.2, 0.2)
# Where noise makes up more than the rest of the slopes in any direction, what is left of them cannot be trusted.
SIGNAL_SHARE = 0.2
# An SDD less certain than this share of itself is not seen: it is held at the calibrated one.
WORST_DISTANCE = 0.02
# A u_c less certain than this share of a cell says nothing about drift.
WORST_CELLS = 0.5
STEPS = 40
# A step below this share of the standard deviations is the last one.
SMALL_STEP = 1e-2
# Which of (u_c, tau, SDD) are fitted.
ALL_THREE, WITHOUT_DISTANCE = slice(0, 3), slice(0, 2)


@dataclass(frozen=True, eq=False)
class _PairedRays:
    """Both rays of each pair, (harmonics, pairs), the opposite ones turned round to lie on the others."""

    half_sum: ComplexArray
    difference: ComplexArray
    slopes: ComplexArray
    noise_slopes: ComplexArray

    @property
    def relative_residual(self) -> float:
        """RMS of the differences against that of the rays."""
        return math.sqrt(float(np.sum(np.abs(self.difference) ** 2) / np.sum(np.abs(self.half_sum) ** 2)))

    def score(self) -> FloatArray:
        """Half the gradient of the squared differences, (3,)."""
        score: FloatArray = np.einsum("xhp,hp->x", self.slopes.conj(), self.difference).real
        return score

    def gram(self, *, corrected: bool) -> FloatArray:
        """(3, 3) of the slopes.

        The slopes are those of noisy data, and their noise makes the Gram matrix too large (errors in variables). Half
        the difference carries as much noise as half the sum and no signal, so its share can be taken off.
        """
        gram = _gram(self.slopes)
        return gram - _gram(self.noise_slopes) if corrected else gram


def _gram(slopes: ComplexArray) -> FloatArray:
    gram: FloatArray = np.einsum("xhp,yhp->xy", slopes.conj(), slopes).real
    return gram


class _Pairs:
    """Paired rays in the Fourier domain of the views, as a function of (u_c, tau, SDD).

    There the turn by gamma is an exact phase, so views are never interpolated. The blur over cells is even in gamma at
    fixed theta, so both rays of a pair are blurred alike. The constant harmonic is left out: what every view has in
    common (errors of the flat field, rings, a background) cannot pass for drift.
    """

    def __init__(
        self, scanner: Scanner, spectrum: ComplexArray, start: FloatArray, blur: tuple[float, float], views: int
    ) -> None:
        self._cells_mm, self._pitch_mm = scanner.cell_centres_mm, scanner.detector_pitch_mm
        self._orders = np.arange(1, len(spectrum) + 1)[:, None]
        self._spectrum = spectrum * np.exp(-0.5 * (blur[0] * self._orders * TAU / views) ** 2)
        fan, _ = self._fan(start)
        spacing = float(np.median(np.diff(fan)))
        self._width = blur[1] * spacing
        pairs = int((min(-fan[0], fan[-1]) - 4.0 * self._width) / spacing)
        if pairs < 8:
            raise DriftError(
                "outside-detector",
                f"the centre of rotation falls on u = {start[0]:.4g} mm, at the detector's edge or beyond: "
                "opposite rays need detector on both sides of it",
            )
        self._gamma = (np.arange(pairs) + 0.5) * spacing

    def _fan(self, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Each cell's fan angle (cells,) and the angle that the cell covers."""
        u_c, tau, sdd = vector
        w = self._cells_mm - u_c
        across, along = w * math.cos(tau), sdd + w * math.sin(tau)
        return np.arctan2(across, along), sdd * math.cos(tau) * self._pitch_mm / (across**2 + along**2)

    def at(self, vector: FloatArray) -> _PairedRays:
        """The pairs with this geometry."""
        fan, covered = self._fan(vector)
        turned = self._spectrum * np.exp(1j * self._orders * fan) * covered
        rays, slope = self._side(turned, fan, 1.0)
        opposite, opposite_slope = self._side(turned, fan, -1.0)
        half_turn = np.where(self._orders % 2, -1.0, 1.0)
        opposite, opposite_slope = half_turn * opposite, -half_turn * opposite_slope
        half_sum, difference = 0.5 * (rays + opposite), rays - opposite
        weights = _shifts(vector, self._gamma), _shifts(vector, -self._gamma)
        return _PairedRays(
            half_sum,
            difference,
            self._slopes(half_sum, 0.5 * (slope + opposite_slope), *weights),
            self._slopes(0.5 * difference, 0.5 * (slope - opposite_slope), *weights),
        )

    def _side(self, turned: ComplexArray, fan: FloatArray, side: float) -> tuple[ComplexArray, ComplexArray]:
        """P(theta + gamma, u(gamma)) at plus or minus the pairs' gamma, and its derivative by gamma at fixed theta."""
        z = (side * self._gamma[None, :] - fan[:, None]) / self._width
        kernel = np.exp(-0.5 * z * z) / (math.sqrt(TAU) * self._width)
        return turned @ kernel, turned @ (-z / self._width * kernel)

    def _slopes(
        self, rays: ComplexArray, by_gamma: ComplexArray, near: FloatArray, opposite: FloatArray
    ) -> ComplexArray:
        """Derivatives of the differences by (u_c, tau, SDD) where both rays of each pair are these, (3, ...).

        A ray's derivative by gamma at fixed view is that at fixed theta less that by theta; the opposite ray has the
        first with its sign turned and the second as it is.
        """
        by_theta = 1j * self._orders * rays
        return (near + opposite)[:, None, :] * by_gamma + (opposite - near)[:, None, :] * by_theta

    def solve(
        self, start: FloatArray, low: FloatArray, high: FloatArray, *, free: slice, corrected: bool
    ) -> tuple[FloatArray, bool]:
        """Gauss-Newton in the free unknowns from the start, inside the reach; whether it came to rest there."""
        vector = start
        for _ in range(STEPS):
            pairs = self.at(vector)
            gram = pairs.gram(corrected=corrected)[free, free]
            if not _is_definite(gram):
                return vector, False
            moved = vector.copy()
            moved[free] -= np.linalg.solve(gram, pairs.score()[free])
            moved = np.clip(moved, low, high)
            small = np.all(np.abs(moved - vector)[free] <= SMALL_STEP * _spread(pairs, gram))
            vector = moved
            if small:
                return vector, bool(np.all((vector > low) & (vector < high)))
        return vector, False


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


def _spread(pairs: _PairedRays, gram: FloatArray) -> FloatArray:
    """Standard deviations (3,) if the differences were white noise."""
    variance = float(np.mean(np.abs(pairs.difference) ** 2))
    spread: FloatArray = np.sqrt(np.diag(np.linalg.inv(gram)) * variance)
    return spread


def _harmonics(sinogram: FloatArray, angles_rad: FloatArray) -> ComplexArray:
    """Fourier coefficients over the views, from the first harmonic up to below Nyquist's, (harmonics, cells).

    Views that are not equidistant are brought to equidistant angles by periodic cubic splines.
    """
    views = len(sinogram)
    wrapped = np.mod(angles_rad, TAU)
    order = np.argsort(wrapped, kind="stable")
    knots = np.append(wrapped[order], wrapped[order[0]] + TAU)
    values = np.concatenate([sinogram[order], sinogram[order[:1]]])
    wanted = knots[0] + np.arange(views) * TAU / views
    even: FloatArray = CubicSpline(knots, values, bc_type="periodic")(wanted)
    spectrum: ComplexArray = np.fft.rfft(even, axis=0)[1 : (views + 1) // 2]
    turned: ComplexArray = spectrum * np.exp(-1j * np.arange(1, len(spectrum) + 1) * knots[0])[:, None]
    return turned


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
    _check(sinogram, angles_rad)
    spectrum = _harmonics(np.asarray(sinogram, np.float64), np.asarray(angles_rad, np.float64))
    views = len(sinogram)
    # Turning the other way is phi -> -phi: the conjugate of every harmonic.
    seen = {rotation: spectrum if rotation is Rotation.AS_GIVEN else spectrum.conj() for rotation in Rotation}
    other = next(sense for sense in Rotation if sense is not rotation)
    valleys = {sense: _valley(scanner, seen[sense], start, views) for sense in (rotation, other)}
    ratio = valleys[other].pairs.relative_residual / valleys[rotation].pairs.relative_residual
    if ratio < 1.0 / DECISIVE_RATIO:
        rotation, ratio = other, 1.0 / ratio
    free = ALL_THREE
    best = _bottom(scanner, seen[rotation], start, valleys[rotation].vector, views, free)
    if not (best.settled and best.covariance[2, 2] < (WORST_DISTANCE * start.source_to_detector_mm) ** 2):
        free = WITHOUT_DISTANCE
        best = _bottom(scanner, seen[rotation], start, valleys[rotation].vector, views, free)
    _check_found(scanner, best, start)
    u_c, tau, sdd = (float(value) for value in best.vector)
    return ConjugateFit(
        u_c, tau, sdd, best.covariance, free == WITHOUT_DISTANCE, rotation, ratio, best.pairs.relative_residual
    )


@dataclass(frozen=True, eq=False)
class _Solution:
    """(u_c, tau, SDD) at the end of a fit, whether it came to rest inside the reach, the pairs and covariance there."""

    vector: FloatArray
    settled: bool
    pairs: _PairedRays
    covariance: FloatArray


def _reach(scanner: Scanner, start: SourceFrame) -> tuple[FloatArray, FloatArray]:
    centre = _vector(start)
    width = scanner.num_detector_pixels * scanner.detector_pitch_mm
    reach = np.array(REACH) * [width, 1.0, start.source_to_detector_mm]
    return centre - reach, centre + reach


def _vector(frame: SourceFrame) -> FloatArray:
    return np.array([frame.cor_column_mm, frame.tilt_rad, frame.source_to_detector_mm])


def _valley(scanner: Scanner, spectrum: ComplexArray, start: SourceFrame, views: int) -> _Solution:
    """The coarse fit, with SDD held: it needs the fine structure of the log."""
    pairs = _Pairs(scanner, spectrum, _vector(start), COARSE, views)
    vector, settled = pairs.solve(_vector(start), *_reach(scanner, start), free=WITHOUT_DISTANCE, corrected=False)
    return _Solution(vector, settled, pairs.at(vector), np.full((3, 3), math.inf))


def _bottom(
    scanner: Scanner, spectrum: ComplexArray, start: SourceFrame, valley: FloatArray, views: int, free: slice
) -> _Solution:
    """The fine fit from the coarse one's end."""
    pairs = _Pairs(scanner, spectrum, valley, FINE, views)
    vector, settled = pairs.solve(valley, *_reach(scanner, start), free=free, corrected=True)
    at_end = pairs.at(vector)
    return _Solution(vector, settled, at_end, _covariance(at_end, views, free))


def _check_found(scanner: Scanner, solution: _Solution, start: SourceFrame) -> None:
    certain = WORST_CELLS * scanner.detector_pitch_mm
    if not solution.covariance[0, 0] < certain**2:
        raise DriftError(
            "nothing-seen",
            f"opposite rays do not place the centre of rotation on the detector to {certain:.3g} mm: average more "
            "rows, scan a log that is less round or less centred, or calibrate with the phantom",
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
        raise DriftError("nothing-seen", "every view of the sinogram is the same: nothing was scanned that turned")


def _covariance(pairs: _PairedRays, views: int, free: slice) -> FloatArray:
    """Cluster-robust covariance of (u_c, tau, SDD), blocks of theta as clusters (Liang and Zeger 1986).

    What is not free has zeros; infinite where the pairs do not show the free ones.
    """
    gram, noisy = (pairs.gram(corrected=corrected)[free, free] for corrected in (True, False))
    if not (_is_definite(noisy) and eigh(gram, noisy, eigvals_only=True)[0] > SIGNAL_SHARE):
        return np.full((3, 3), math.inf)
    differences = _over_theta(pairs.difference, views)
    scores = np.stack([(_over_theta(slope, views) * differences).sum(axis=1) for slope in pairs.slopes[free]], -1)
    blocks = np.add.reduceat(scores, np.arange(BLOCKS) * views // BLOCKS, axis=0)
    # By Parseval the sum over one side of the spectrum is half of views times the sum over theta.
    meat = (0.5 * views) ** 2 * blocks.T @ blocks * BLOCKS / (BLOCKS - 3)
    bread = np.linalg.inv(gram)
    covariance = np.zeros((3, 3))
    covariance[free, free] = bread @ meat @ bread
    return covariance


def _over_theta(harmonics: ComplexArray, views: int) -> FloatArray:
    """(harmonics, pairs) as (views, pairs) over theta."""
    spectrum = np.zeros((views // 2 + 1, harmonics.shape[1]), np.complex128)
    spectrum[1 : len(harmonics) + 1] = harmonics
    return np.fft.irfft(spectrum, views, axis=0)
