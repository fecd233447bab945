"""Whether the phantom, or the angles, kept still during the scan.

What the fit left of the scan is compared, to first order, with what a jump of the pose from some view on, angles that
run too fast or too slowly, and angles that swing once a turn would have left. Every inner product that this needs is in
the per-view Gram matrices of least squares.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from worker.tomography.analytic import PARAMETERS
from worker.tomography.calibration.refine import DATA, MODEL, ONE, Fit, SinogramData, project_out
from worker.tomography.calibration.structure import shared_power
from worker.tomography.geometry import FloatArray

PSI, T_X, T_Y = 0, 5, 6
# A wrong drawing or wood that is not uniform looks like one of these by a tenth; a phantom that moved 20 mm, far beyond
# first order, by a half.
EXPLAINS = 0.4
# Of white noise the best of several hundred jumps takes so many variances once in a thousand scans.
CHANCE = 30.0
# A jump is known by so many views before and after it.
FEWEST_VIEWS = 3
# A jump that moves the phantom by less than this share of what it turns its rim by is one of the angles.
TURN_ALONE = 0.1


class Change(StrEnum):
    """What changed."""

    PHANTOM = "phantom"
    ANGLES = "angles"
    PACE = "pace"
    SWING = "swing"


@dataclass(frozen=True, eq=False)
class Unsteadiness:
    """What changed during the scan.

    Attributes
    ----------
    change : Change
    explains : float
        The share of the residual's power, less that of noise, which this accounts for.
    bias : (7,) float64
        By how much (psi, R, SDD, u_c, tau, t_x, t_y) are off for not knowing of it.
    by_deg, by_mm : float
        Turn and move of the phantom in a jump; the most that angles are off in a swing.
    view : int
        The first view after a jump.
    pace : float
        How far the turntable turns while the angles say 1.
    """

    change: Change
    explains: float
    bias: FloatArray
    by_deg: float = 0.0
    by_mm: float = 0.0
    view: int = 0
    pace: float = 1.0


def find_unsteadiness(
    grams: FloatArray, data: SinogramData, fit: Fit, residual: FloatArray, *, radius_mm: float
) -> Unsteadiness | None:
    """What explains most of a residual (views, cells), if anything here does.

    Parameters
    ----------
    grams : (views, 10 or 13, 10 or 13) float64
        `analytic.gram` at the fit.
    residual : (views, cells) float64
        0 where nothing may be used.
    radius_mm : float
        Of the phantom.
    """
    left = _Left(grams, data, fit, shared_power(residual))
    found, explained = max((_jump(left, radius_mm), _pace(left), _swing(left)), key=lambda change: change[1].power)
    return found if explained.power > CHANCE * left.variance and found.explains > EXPLAINS else None


@dataclass(frozen=True, eq=False)
class _Explanation:
    """What additional derivatives explain: power, its share, their coefficients, and what the fit is off by."""

    power: float
    share: float
    coefficients: FloatArray
    bias: FloatArray
    trial: int


class _Left:
    """What the fit left, and how much of it additional derivatives explain."""

    def __init__(self, grams: FloatArray, data: SinogramData, fit: Fit, shared: float) -> None:
        self.angles = data.angles_rad
        self._free = [i for i in range(PARAMETERS) if fit.covariance[i, i] > 0.0]
        self._gain = fit.gain
        if data.view_gain:
            rest = [*range(PARAMETERS), DATA, *data.extras]
            seen = grams[:, MODEL, MODEL] > 1e-9 * grams[:, MODEL, MODEL].max()
            free_of_them = np.zeros_like(grams)
            free_of_them[np.ix_(np.flatnonzero(seen), rest, rest)] = project_out(grams[seen], [MODEL, ONE], rest)[0]
            self.grams, linear = free_of_them, list(data.extras)
        else:
            self.grams, linear = grams, [MODEL, ONE, *data.extras]
        self._known = [*self._free, *linear]
        self._total = self.grams.sum(axis=0)
        self._scale = 1.0 / np.sqrt(np.diag(self._total)[self._known])
        rss = project_out(self._total, self._known, [DATA])[0].item()
        self._beyond_noise = shared * data.sinogram.size
        self.variance = max(rss / data.samples - shared, 0.0)

    def shaped(self, which: list[int], shapes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Inner products of derivatives `which`, each times its shape (terms, views): with all, and their own."""
        grams = self.grams[:, which]
        return np.einsum("tk,kti->ti", shapes, grams), np.einsum("tk,sk,kts->ts", shapes, shapes, grams[:, :, which])

    def explained(self, products: FloatArray, own: FloatArray) -> _Explanation:
        """By the best of some trials: products (trials, terms, 10 or 13), own (trials, terms, terms)."""
        cross = products[:, :, self._known] * self._scale
        normal = self._total[np.ix_(self._known, self._known)] * np.outer(self._scale, self._scale)
        solved = np.linalg.solve(normal, np.swapaxes(cross, 1, 2))
        matrix = own - cross @ solved
        right = products[:, :, DATA] - (self._scale * self._total[self._known, DATA]) @ solved
        coefficients = (np.linalg.pinv(matrix, rcond=1e-9, hermitian=True) @ right[..., None])[..., 0]
        powers = np.einsum("nt,nt->n", right, coefficients)
        best = int(powers.argmax())
        # Where nothing is left to explain, rounding may be negative.
        power, bias = max(float(powers[best]), 0.0), np.zeros(PARAMETERS)
        moved = -(solved[best] @ coefficients[best]) * self._scale
        bias[self._free] = moved[: len(self._free)] / self._gain
        # What is not noise cannot be less than what is explained.
        share = power / max(power, self._beyond_noise, np.finfo(np.float64).tiny)
        return _Explanation(power, share, coefficients[best] / self._gain, bias, best)


def _jump(left: _Left, radius_mm: float) -> tuple[Unsteadiness, _Explanation]:
    """Of the pose, from some view on."""
    pose = [PSI, T_X, T_Y]
    # Of the views from each on, the first and the last few left out.
    after = np.cumsum(left.grams[::-1, pose], axis=0)[::-1][FEWEST_VIEWS : len(left.grams) - FEWEST_VIEWS + 1]
    found = left.explained(after, after[:, :, pose])
    turn, *move = found.coefficients
    by_mm = math.hypot(*move)
    change = Change.ANGLES if by_mm < TURN_ALONE * abs(turn) * radius_mm else Change.PHANTOM
    by_deg, view = math.degrees(abs(turn)), FEWEST_VIEWS + found.trial
    return Unsteadiness(change, found.share, found.bias, by_deg=by_deg, by_mm=by_mm, view=view), found


def _pace(left: _Left) -> tuple[Unsteadiness, _Explanation]:
    """Angles that run too fast or too slowly."""
    products, own = left.shaped([PSI], (left.angles - left.angles.mean())[None])
    found = left.explained(products[None], own[None])
    return Unsteadiness(Change.PACE, found.share, found.bias, pace=1.0 + float(found.coefficients[0])), found


def _swing(left: _Left) -> tuple[Unsteadiness, _Explanation]:
    """Angles that are ahead and behind once a turn."""
    products, own = left.shaped([PSI, PSI], np.stack([np.cos(left.angles), np.sin(left.angles)]))
    found = left.explained(products[None], own[None])
    by_deg = math.degrees(math.hypot(*found.coefficients))
    return Unsteadiness(Change.SWING, found.share, found.bias, by_deg=by_deg), found
