"""The fit of all cells: pairs, poses, the board as it is, and each pair's beam and detector.

Everything that a scan may hide is an unknown with the size that it may have as prior, so that it is fitted where the
scan shows it and widens the bound where it does not.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.calibration.covariance import scaled_inverse
from sawmill_tomography.calibration.joint_fit.sample_noise import LEAST_NOISE, sample_noise
from sawmill_tomography.calibration.joint_fit.scan_model import LARGEST, ScanModel, Term
from sawmill_tomography.calibration.joint_fit.wood_patches import Variation, variation, wood_patches
from sawmill_tomography.calibration.sinogram_data import SinogramData
from sawmill_tomography.geometry.geometry import TAU, FloatArray
from sawmill_tomography.pairs.coarse import Placed, possible
from sawmill_tomography.pairs.passages import PairData, by_pose, mapped, seen_by_views
from sawmill_tomography.phantoms.phantom import Disc, Phantom, Shape
from sawmill_tomography.sinograms.scattered_radiation import halo
from sawmill_tomography.statistics import robust_deviation

# Unknowns of the board's wood, alike for all pairs, and of each pair: standard deviations of the priors.
OF_WOOD = {Term.ASPECT: 3e-3, Term.SHEAR: 3e-3, Term.CORNERS: 9.0, Term.GRADIENT_X: 5e-4, Term.GRADIENT_Y: 5e-4}
OF_PAIR = {Term.BLUR: 2.0}
# Steps over which rounded corners, mm^2, blur, cells^2, and places of corners, mm, are differentiated.
ROUND_STEP, BLUR_STEP, CORNER_STEP_MM = 1.0, 0.05, 0.05
# Scatter of the intensity that wood takes out of the beam: halos with these standard deviations on the detector, and
# the mean of the view; of each pair.
HALOS_MM, SCATTER = (25.0, 75.0, 200.0), 0.05
# Hardening of the beam: what the second, third and fourth power of the line integral add at the longest path, as a
# share of it.
BENDS = (0.3, 0.1, 0.03)
SCATTERED = slice(len(OF_PAIR), len(OF_PAIR) + len(HALOS_MM) + 1)
BENT = slice(SCATTERED.stop, SCATTERED.stop + len(BENDS))
OF_OPTICS = BENT.stop
# Of each view: gain, relative to the first estimate, and level, slope and curvature across the detector.
OF_VIEW = (0.3, 0.02, 0.01, 0.01)
# The fan of each pair: its place along the feed about the stated one, mm, and its slopes against the cross-section; and
# the step over which a slope's effect is differentiated.
OF_FAN, SHEAR_STEP = (5.0, 0.01, 0.01), 1e-4
# A traced drawing with more corners keeps its shape up to stretching and shearing.
MOST_CORNERS = 24
# A step that lowers the power by less, in variances of a sample, is the last.
STEPS, CONVERGED, ROUGHLY, PARTS = 30, 0.1, 1e-3, (1.0, 0.5, 0.25)
# Neighbouring cells whose residuals are compared.
LAGS = 24
# The unit of what the board moves while it is fed, mm at its rim: `variation` compares 0.01 to 2 mm.
SWING_MM = 10.0
# Standard deviations of densities of patches that do not vary, and the precision of what is held.
LEAST_VARIATION, HELD = 1e-4, 1e14
# Rounded corners, mm^2, and blur, cells^2, of smaller sizes are none.
LEAST_SIZE = 1e-3
# At least 5 % of the intensity remain.
LEAST_ADDED = -0.95
# At least this share of a sample's variance is its own.
OWN_SHARE = 0.2


@dataclass(frozen=True, eq=False)
class Layout:
    """The places of the unknowns in one vector."""

    pairs: int
    passages: int
    sloped: bool  # True if groups of rows tell how the poses change along the feed
    corners: int
    patches: int

    @cached_property
    def starts(self) -> FloatArray:
        """Where frames, poses, their slopes, wood, corners, optics, views, fans, swings, patches begin, and the end."""
        of_slopes = 3 * self.passages if self.sloped else 0
        lengths = (
            5 * self.pairs,
            3 * self.passages,
            of_slopes,
            len(OF_WOOD),
            self.corners,
            OF_OPTICS * self.pairs,
            len(OF_VIEW) * self.pairs * self.passages,
            len(OF_FAN) * self.pairs if self.sloped else 0,
            3 * self.pairs * self.passages,
            self.patches,
        )
        return np.cumsum([0, *lengths])

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self.starts[-1])

    def part(self, number: int) -> slice:
        """Return the place of the part with this number among `starts`."""
        return slice(int(self.starts[number]), int(self.starts[number + 1]))


FRAMES, POSES, SLOPES, WOOD, CORNERS, OPTICS, VIEWS, FANS, SWINGS, PATCHES = range(10)


class FineFit:
    """The unknowns of all at one point, with the normal equations there.

    Parameters
    ----------
    board : Phantom
        The drawing as it is seen.
    data : sequence of PairData
        The line integrals of each pair.
    start : Placed
        Frames and poses.
    corner_mm : float
        Standard deviation of the drawing's corners, mm.
    """

    def __init__(
        self, board: Phantom, data: Sequence[PairData], start: Placed, *, from_counts: bool, corner_mm: float
    ) -> None:
        self.board, self.data, self.from_counts, self.corner_mm = board, data, from_counts, corner_mm
        passages, groups, _ = data[0].lines.shape
        self.layout = Layout(len(data), passages, groups > 1, corners_of(board), len(wood_patches(board)))
        self.x = np.zeros(self.layout.size)
        self.x[self.layout.part(FRAMES)], self.x[self.layout.part(POSES)] = start.frames.ravel(), start.poses.ravel()
        deviations = np.full(self.layout.size, np.inf)
        deviations[self.layout.part(WOOD)] = [*OF_WOOD.values()]
        deviations[self.layout.part(CORNERS)] = corner_mm
        of_pair = [*OF_PAIR.values(), *[SCATTER] * (len(HALOS_MM) + 1), *BENDS]
        deviations[self.layout.part(OPTICS)] = np.tile(of_pair, len(data))
        deviations[self.layout.part(VIEWS)] = [*OF_VIEW] * (len(data) * passages)
        deviations[self.layout.part(FANS)] = [*OF_FAN] * (len(data) if self.layout.sloped else 0)
        deviations[self.layout.part(SWINGS)] = HELD**-0.5
        deviations[self.layout.part(PATCHES)] = LEAST_VARIATION
        self.precision = 1.0 / deviations**2
        # The first pose is the gauge.
        self.precision[self.layout.part(POSES)][:3] = HELD
        self.held = self.x.copy()
        self.lines = [one.lines.reshape(-1, one.cells.count) for one in data]
        # What patches of wood add to the primary line integrals for each unit of their density, and to the prediction.
        self.patches = [np.zeros((0, *lines.shape)) for lines in self.lines]
        self.patch_columns = [*self.patches]
        # What a fan's place and slopes add, in the same way; and what the mean over a group's rows and the slant add.
        self.fans = [np.zeros((len(OF_FAN), *lines.shape)) for lines in self.lines]
        self.fan_columns = [*self.fans]
        self.smeared = [np.zeros_like(lines) for lines in self.lines]
        self.weights = [np.ones_like(lines) for lines in self.lines]
        self.shares = [np.zeros(one.cells.count) for one in data]
        self._of_densities = dict[int, FloatArray]()
        # Per mm, by regression of the lines on the board's lengths.
        self.attenuation = [1.0] * len(data)
        models = [self.model(self.x, number).with_view_gains(weights) for number, weights in enumerate(self.weights)]
        self.attenuation = [float(np.median(model.gain)) for model in models]
        self.longest = [float(np.ptp(lines)) for lines in self.lines]
        self.weigh()

    def of_rows(self, data: Sequence[PairData]) -> "FineFit":
        """Return the fit at the same point for data in groups of rows."""
        fit = FineFit(self.board, data, self.placed, from_counts=self.from_counts, corner_mm=self.corner_mm)
        for part in (WOOD, CORNERS, OPTICS, VIEWS):
            fit.x[fit.layout.part(part)] = self.x[self.layout.part(part)]
        fit.attenuation, fit.longest = self.attenuation, self.longest
        fit.weigh()
        return fit

    @property
    def placed(self) -> Placed:
        """Frames and poses."""
        return self._placed(self.x)

    def _placed(self, x: FloatArray) -> Placed:
        frames, poses = (x[self.layout.part(part)] for part in (FRAMES, POSES))
        return Placed(frames.reshape(-1, 5), poses.reshape(-1, 3), 0.0)

    def _poses(self, x: FloatArray, number: int, further_mm: float = 0.0) -> FloatArray:
        """Return the pose in each view of one pair, or further along the feed, (views, 3)."""
        heights, swings = self.data[number].heights_mm + further_mm, x[self.layout.part(SWINGS)]
        poses = (self._placed(x).poses + swings.reshape(self.layout.pairs, -1, 3)[number])[:, None]
        if self.layout.sloped:
            poses = poses + heights[:, None] * x[self.layout.part(SLOPES)].reshape(-1, 1, 3)
        return np.reshape(poses, (-1, 3))

    def model(self, x: FloatArray, number: int, further_mm: float = 0.0) -> ScanModel:
        """Return the forward model of one pair without scatter; its views are the groups of rows of all passages."""
        layout, data, lines = self.layout, self.data[number], self.lines[number]
        angles, positions = seen_by_views(self._poses(x, number, further_mm))
        optics = self._optics(x, number)[: len(OF_PAIR)]
        sizes: dict[int, float] = dict(zip((*OF_WOOD, *OF_PAIR), (*x[layout.part(WOOD)], *optics), strict=True))
        sizes |= {term: 0.0 for term in LARGEST if sizes.get(Term(term), 0.0) < LEAST_SIZE}
        gain, *levels = x[layout.part(VIEWS)].reshape(layout.pairs, layout.passages, -1)[number].T
        groups = len(lines) // layout.passages
        return ScanModel(
            with_corners(self.board, x[layout.part(CORNERS)]),
            SinogramData(lines, np.zeros(len(lines)), data.cells),
            self.from_counts,
            np.concatenate([self._placed(x).frames[number], [0.0, 0.0]]),
            self.attenuation[number] * np.repeat(1.0 + gain, groups)[:, None],
            np.repeat(np.transpose(levels) @ self._smooth(number), groups, axis=0),
            np.column_stack([angles, positions]),
            sizes,
            view_gain=True,
        )

    def _optics(self, x: FloatArray, number: int) -> FloatArray:
        return np.asarray(x[self.layout.part(OPTICS)].reshape(self.layout.pairs, -1)[number])

    def prediction(self, x: FloatArray, number: int) -> FloatArray:
        """Return the line integrals (views, cells) that one pair should measure."""
        primary = self._primary(x, number, self.model(x, number))
        if not self._optics(x, number)[SCATTERED].any():
            return primary
        return np.asarray(primary - np.log(self._halos(x, number, primary)[1]))

    def _primary(self, x: FloatArray, number: int, model: ScanModel) -> FloatArray:
        """Return the line integrals of one pair without scatter."""
        bent = self._bent(number, self._straight(number, model))
        lines = model.prediction + np.tensordot(self._optics(x, number)[BENT], bent, 1)
        densities = x[self.layout.part(PATCHES)][: len(self.patches[number])]
        lines = lines + np.tensordot(densities, self.patches[number], 1) + self.smeared[number]
        if not self.layout.sloped:
            return np.asarray(lines)
        fan = x[self.layout.part(FANS)].reshape(self.layout.pairs, -1)[number]
        return np.asarray(lines + np.tensordot(fan, self.fans[number], 1))

    def _straight(self, number: int, model: ScanModel) -> FloatArray:
        """Return the line integrals of a beam that does not harden, by the pair's attenuation, (views, cells)."""
        return np.asarray((model.prediction - model.offset) * (self.attenuation[number] / model.gain))

    def _smooth(self, number: int) -> FloatArray:
        """Return the shapes of what flat fields leave across the detector: level, slope and curvature, (3, cells)."""
        cells = self.data[number].cells.count
        return np.asarray(((np.arange(cells) + 0.5) / cells - 0.5) ** np.arange(3)[:, None])

    def _bent(self, number: int, straight: FloatArray) -> FloatArray:
        """Return what hardening adds for each power, (powers, views, cells)."""
        share = straight / self.longest[number]
        return np.stack([straight * share, straight * share**2, straight * share**3])

    def _halos(self, x: FloatArray, number: int, primary: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what scatter of each kind adds as a share of a cell's own intensity, and the whole intensity so."""
        if not self.from_counts:
            return np.zeros((len(HALOS_MM) + 1, *primary.shape)), np.ones_like(primary)
        halos = self._spread(-np.expm1(-primary), number) * np.exp(primary)
        added = np.tensordot(self._optics(x, number)[SCATTERED], halos, 1)
        return halos, np.asarray(1.0 + np.maximum(added, LEAST_ADDED))

    def _spread(self, lost: FloatArray, number: int) -> FloatArray:
        """Return where intensity that is lost in the cells (..., cells) is scattered to, (kinds, ..., cells)."""
        width = self.data[number].cells.width_mm
        halos = [halo(lost, round(math.sqrt(6.0) * one / width)) for one in HALOS_MM]
        return np.array([*halos, np.broadcast_to(lost.mean(axis=-1, keepdims=True), lost.shape)])

    def residual(self, x: FloatArray, number: int) -> FloatArray:
        """Return what one pair measured less its prediction, (views, cells)."""
        return np.asarray(self.lines[number] - self.prediction(x, number))

    def weigh(self) -> None:
        """Weigh the samples by the inverse of their noise, which is measured on differences of neighbours."""
        for number, lines in enumerate(self.lines):
            predicted = self.prediction(self.x, number)
            data = SinogramData(lines, np.zeros(len(lines)), self.data[number].cells)
            variance = sample_noise(data, lines - predicted, predicted).variance
            least = max(LEAST_NOISE * float(variance.mean()), (1e-6 * float(np.ptp(lines))) ** 2)
            stripes = striped(lines - predicted)
            self.weights[number] = 1.0 / np.maximum(variance - stripes, np.maximum(OWN_SHARE * variance, least))
            # Of each cell's sum over the views, what its flat field leaves in all views alike.
            self.shares[number] = stripes / (1.0 + stripes * self.weights[number].sum(axis=0))
        self._of_densities = {}

    def power(self, x: FloatArray, by: "FineFit | None" = None) -> float:
        """Return the sum of squares of the residual, weighted as in a fit, and of the departures from the priors."""
        total, by = float(self.precision @ (x - self.held) ** 2), by or self
        for number, weights in enumerate(by.weights):
            residual = self.residual(x, number)
            weighted = weights * residual
            total += float((weighted * residual).sum() - by.shares[number] @ weighted.sum(axis=0) ** 2)
        return total

    def columns(self, x: FloatArray, number: int) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
        """Return the places of the unknowns of one pair, their columns (n, views, cells), and the residual.

        All are times the root of the weights.
        """
        layout, model = self.layout, self.model(x, number)
        rows, views, passages = model.deformations, len(model.gain), layout.passages
        primary = self._primary(x, number, model)
        halos, total = self._halos(x, number, primary)
        predicted = primary - np.log(total)
        blurring, through = self._blurring(model), self._scattering(x, number, primary, total)

        def soft(rows: FloatArray) -> FloatArray:
            return through(blurring(rows))

        straight, bends = self._straight(number, model), self._optics(x, number)[BENT] * [2.0, 3.0, 4.0]
        steeper = np.polynomial.polynomial.polyval(straight / self.longest[number], [0.0, *bends])
        chain = model.gain + self.attenuation[number] * steeper
        of_passage = np.repeat(np.eye(passages), views // passages, axis=1)[:, None, :, None]
        heights = np.tile(self.data[number].heights_mm, passages)[:, None]
        pose = soft(chain * by_pose(self._poses(x, number), rows[0], rows[5:7]))
        poses = (of_passage * pose).reshape(-1, *predicted.shape)
        rounder = {**model.sizes, Term.CORNERS: model.size(Term.CORNERS) + ROUND_STEP}
        rounding = (replace(model, sizes=rounder).lengths - model.lengths) / ROUND_STEP
        wider = x.copy()
        wider[layout.part(OPTICS).start + OF_OPTICS * number] += BLUR_STEP
        blurred = (self.prediction(wider, number) - predicted) / BLUR_STEP
        optics = [blurred, *(-halos / total), *through(self._bent(number, straight))]
        smooth = np.broadcast_to(self._smooth(number)[:, None], (len(OF_VIEW) - 1, *predicted.shape))
        gains = soft(np.concatenate([[model.sharp - model.offset], smooth]))
        gains[0] *= self.attenuation[number] / model.gain
        of_views = (of_passage * gains).reshape(-1, *predicted.shape)
        parts = {
            FRAMES: (5 * number, soft(chain * rows[:5])),
            POSES: (0, poses),
            WOOD: (0, soft(chain * np.stack([rows[10], rows[11], rounding, rows[8], rows[9]]))),
            CORNERS: (0, soft(chain * self._moved_corners(x, model))),
            OPTICS: (OF_OPTICS * number, np.array(optics)),
            VIEWS: (len(of_views) * number, of_views),
            SWINGS: (len(poses) * number, poses),
        }
        if layout.sloped:
            parts[SLOPES] = (0, heights * poses)
            parts[FANS] = (len(OF_FAN) * number, self.fan_columns[number])
        parts[PATCHES] = (0, self.patch_columns[number])  # the last, as `_products` has them
        places = [layout.part(part).start + first + np.arange(len(own)) for part, (first, own) in parts.items()]
        root = np.sqrt(self.weights[number])
        columns = np.concatenate([own for _, own in parts.values()])
        return np.concatenate(places), columns * root, (self.lines[number] - predicted) * root

    def _moved_corners(self, x: FloatArray, model: ScanModel) -> FloatArray:
        """Return the derivatives of the lengths by the places of the corners, (coordinates, views, cells)."""
        corners = x[self.layout.part(CORNERS)]
        moved = np.zeros((corners.size, *model.lengths.shape))
        for one, step in enumerate(CORNER_STEP_MM * np.eye(corners.size)):
            there = replace(model, drawing=with_corners(self.board, corners + step))
            moved[one] = (there.lengths - model.lengths) / CORNER_STEP_MM
        return moved

    def _scattering(
        self, x: FloatArray, number: int, primary: FloatArray, total: FloatArray
    ) -> Callable[[FloatArray], FloatArray]:
        """Return the map from changes of primary line integrals to changes of the prediction, to first order."""
        scatter, own = self._optics(x, number)[SCATTERED], np.exp(primary)
        if not scatter.any():
            return np.asarray
        return lambda rows: np.asarray(
            (rows - np.tensordot(scatter, self._spread(rows / own, number), 1) * own) / total
        )

    def _blurring(self, model: ScanModel) -> Callable[[FloatArray], FloatArray]:
        """Return the map from changes of sharp line integrals to changes of blurred ones, to first order."""
        if not model.taps.size:
            return np.asarray
        before, after = (np.exp(-model.exposed), np.exp(model.blurred)) if self.from_counts else (1.0, 1.0)
        return lambda rows: np.asarray(
            scipy.ndimage.correlate1d(before * rows, model.taps, axis=-1, mode="reflect") * after
        )

    def system(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the normal matrix and the score of all unknowns, priors included."""
        normal, score = np.diag(self.precision), -self.precision * (x - self.held)
        for number in range(len(self.data)):
            places, columns, residual = self.columns(x, number)
            flat = columns.reshape(len(columns), -1)
            normal[np.ix_(places, places)] += self._products(flat, number)
            score[places] += flat @ residual.ravel()
            sums, shared = self._sums(columns, number), self.shares[number]
            normal[np.ix_(places, places)] -= (sums * shared) @ sums.T
            score[places] -= (sums * shared) @ self._sums(residual, number)
        return normal, score

    def _sums(self, rows: FloatArray, number: int) -> FloatArray:
        """Return the sums (..., cells) over the views of rows that are times the root of the weights."""
        return np.asarray((rows * np.sqrt(self.weights[number])).sum(axis=-2))

    def _products(self, columns: FloatArray, number: int) -> FloatArray:
        """Return the products (n, n) of columns (n, samples); patches, which are the last, are multiplied once."""
        patches = len(self.patches[number])
        if number not in self._of_densities:
            self._of_densities[number] = columns[len(columns) - patches :] @ columns[len(columns) - patches :].T
        others = columns[: len(columns) - patches] @ columns.T
        mixed = others[:, len(others) :]
        return np.block([[others[:, : len(others)], mixed], [mixed.T, self._of_densities[number]]])

    def solve(self, share: float = 0.0) -> bool:
        """Take Gauss-Newton steps, damped where they do not lower the power; return whether they have converged.

        A step that lowers the power by less than this share is the last, too.
        """
        before, damping = self.power(self.x), 0.0
        for _ in range(STEPS):
            normal, score = self.system(self.x)
            whole = damping
            for _ in range(8):
                step = self._step(normal, score, damping)
                # Scatter and hardening are not linear: a part of a long step may lower what the whole step does not.
                for part in PARTS:
                    there, after = self.x + part * step, math.inf
                    if possible(with_corners(self.board, there[self.layout.part(CORNERS)]), self._placed(there)):
                        # Far off, intensities may be no numbers: such a step is not taken.
                        with np.errstate(over="ignore", invalid="ignore"):
                            after = self.power(there)
                    if after < before:
                        break
                if after < before:
                    break
                damping = max(10.0 * damping, 1e-4)
            else:
                return True
            self.x, gained, before, damping = there, before - after, after, damping * (0.1 if damping == whole else 1.0)
            if gained < max(CONVERGED, share * before):
                return True
        return False

    def settle(self) -> None:
        """Fit with the board as it is drawn, then as it is."""
        own, self.precision = self.precision, self.precision.copy()
        self.precision[self.layout.part(WOOD).start : self.layout.part(CORNERS).stop] = HELD
        self.solve(share=ROUGHLY)
        self.weigh()
        self.precision = own
        self.solve(share=ROUGHLY)

    def _step(self, normal: FloatArray, score: FloatArray, damping: float) -> FloatArray:
        """Return the step that solves the normal equations; sizes that cannot be negative end at 0 or more."""
        scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
        scaled = normal * np.outer(scale, scale) + (damping + 1e-11) * np.eye(len(scale))
        step, free = np.zeros(len(scale)), np.ones(len(scale), bool)
        low, high = self._limits
        while True:
            left = score[free] - normal[np.ix_(free, ~free)] @ step[~free]
            step[free] = scale[free] * np.linalg.solve(scaled[np.ix_(free, free)], scale[free] * left)
            beyond = free & ((self.x + step < low) | (self.x + step > high))
            if not beyond.any():
                return step
            step[beyond] = np.clip(self.x + step, low, high)[beyond] - self.x[beyond]
            free &= ~beyond

    @cached_property
    def _limits(self) -> tuple[FloatArray, FloatArray]:
        """The least and the largest value of each unknown."""
        low, high = np.full((2, self.layout.size), np.inf) * np.array([[-1.0], [1.0]])
        starts = self.layout.part(OPTICS).start + OF_OPTICS * np.arange(self.layout.pairs)
        for terms, first in ((OF_WOOD, np.array([self.layout.part(WOOD).start])), (OF_PAIR, starts)):
            for place, term in enumerate(terms):
                if term in LARGEST:
                    low[first + place], high[first + place] = 0.0, LARGEST[term]
        return low, high

    def vary_fans_and_densities(self) -> None:
        """Let fans lie out of the cross-section, and the wood's density vary by patch as much as the scan says."""
        for number in range(len(self.data)):
            model = self.model(self.x, number)
            body, primary = model.drawing, self._primary(self.x, number, model)
            through = self._scattering(self.x, number, primary, self._halos(self.x, number, primary)[1])
            blurring = self._blurring(model)
            if self.layout.sloped:
                # Neighbouring groups are as far apart as each is long: two points have the mean of the rows (Gauss).
                half_mm = float(np.diff(self.data[number].heights_mm).mean()) / math.sqrt(12.0)
                ends = [self.model(self.x, number, way * half_mm).lengths for way in (-1.0, 1.0)]
                *fans, slanted = self._sheared(number, model)
                self.smeared[number] = blurring(model.gain * (np.mean(ends, axis=0) - model.lengths + slanted))
                self.fans[number] = blurring(model.gain * np.array(fans))
                self.fan_columns[number] = through(self.fans[number])
            lengths = [model.project(replace(body, shapes=shapes)) for shapes in wood_patches(self.board)]
            self.patches[number] = blurring(model.gain * np.array(lengths))
            self.patch_columns[number] = through(self.patches[number])
        self._of_densities = {}
        self.x[self.layout.part(PATCHES)] = 0.0
        varies = variation(*self._left(self.layout.part(PATCHES)), 1.0)
        self.precision[self.layout.part(PATCHES)] = 1.0 / max(varies.deviation, LEAST_VARIATION) ** 2

    def _left(self, part: slice) -> tuple[FloatArray, FloatArray]:
        """Return the normal matrix and the score of some unknowns, without priors, next to all others."""
        normal, score = self.system(self.x)
        others = np.delete(np.arange(self.layout.size), part)
        normal[part, part] -= np.diag(self.precision[part])
        score[part] += self.precision[part] * (self.x - self.held)[part]
        taken = normal[part, others] @ scaled_inverse(normal[np.ix_(others, others)])
        left = normal[part, part] - taken @ normal[others, part]
        return left, score[part] - taken @ score[others] + left @ self.x[part]

    def let_swing(self, *, apart: bool) -> Variation:
        """Let each pair see the board elsewhere in each passage, in units of `SWING_MM`, as much as the scan says.

        `apart`: the pairs are known to stand apart along the feed, so that it is as much as the scan does not exclude.
        """
        unit = np.tile(SWING_MM / np.array([1.0, 1.0, self.board.radius_mm]), self.layout.pairs * self.layout.passages)
        left, seen = self._left(self.layout.part(SWINGS))
        swings = variation(left * np.outer(unit, unit), seen * unit, 1.0)
        likely = swings.largest if apart else swings.deviation
        self.precision[self.layout.part(SWINGS)] = 1.0 / (likely * unit) ** 2
        return swings

    def _sheared(self, number: int, model: ScanModel) -> FloatArray:
        """Return the change of lengths by the fan's place and slopes, and by the board's slant, (4, views, cells)."""
        # A board with the slope s lies elsewhere by s z: a fan in z = a . x sees it as rays mapped by 1 - s a would.
        # Its cross-section is longer along s, by half the square of s.
        rows, frame = model.deformations, self._placed(self.x).frames[number]
        slopes = self.x[self.layout.part(SLOPES)].reshape(-1, 3)
        groups, same = len(rows[0]) // len(slopes), mapped(frame, np.eye(2), np.zeros(2))
        changes = np.zeros((3, len(slopes), len(frame)))
        for passage, slope in enumerate(slopes[:, :2]):
            for place, along in enumerate((*np.eye(2), 0.5 * slope)):
                shear = np.eye(2) - SHEAR_STEP * np.outer(slope, along)
                change = mapped(frame, shear, np.zeros(2)) - same
                changes[place, passage] = np.array([math.remainder(change[0], TAU), *change[1:]]) / SHEAR_STEP
        pose = by_pose(self._poses(self.x, number), rows[0], rows[5:7])
        shifted = np.einsum("vp,pvc->vc", np.repeat(slopes, groups, axis=0), pose)
        return np.stack([shifted, *np.einsum("avf,fvc->avc", np.repeat(changes, groups, axis=1), rows[:5])])

    def let_knots_differ(self) -> None:
        """Let single patches differ more than the others, as knots do: densities have the tails of a Cauchy's."""
        densities = self.x[self.layout.part(PATCHES)]
        scale = max(robust_deviation(densities), LEAST_VARIATION)
        self.precision[self.layout.part(PATCHES)] = 2.0 / (scale**2 + densities**2)

    def off_drawing_mm(self) -> float:
        """Return how far the coordinates of the board's corners are off the drawing's, RMS, mm."""
        at, moved = np.concatenate([*map(_points, self.board.shapes)]), self.x[self.layout.part(CORNERS)].reshape(-1, 2)
        aspect, shear = self.x[self.layout.part(WOOD)][:2]
        stretched = 0.5 * (aspect * at * [1.0, -1.0] + shear * at[:, ::-1])
        return float(np.sqrt(np.mean((stretched + (moved if moved.size else 0.0)) ** 2)))

    def share_left(self) -> float:
        """Return the RMS of the residual as a share of the RMS of the shadows."""
        left = sum(float((self.residual(self.x, number) ** 2).sum()) for number in range(len(self.data)))
        return math.sqrt(left / sum(one.shadow_power for one in self.data))

    def temper(self) -> None:
        """Weigh all samples less, by what neighbouring cells share in the residual: misfit is weak evidence."""
        residuals = [self.residual(self.x, number) * np.sqrt(weights) for number, weights in enumerate(self.weights)]
        groups = self.data[0].lines.shape[1]
        shared = correlation([_of_groups(one, groups) for one in residuals])
        excess = max(1.0, 1.0 + float(shared[0] + 2.0 * shared[1:].sum()))
        self.weights, self._of_densities = [weights / excess for weights in self.weights], {}
        self.shares = [shares * excess for shares in self.shares]

    def covariance(self) -> FloatArray:
        """Return the covariance of all unknowns: what neighbouring cells share in the residual counts once."""
        normal, _ = self.system(self.x)
        spread, groups = normal.copy(), self.data[0].lines.shape[1]
        parts = [self.columns(self.x, number) for number in range(len(self.data))]
        shared = correlation([_of_groups(residual, groups) for _, _, residual in parts])
        for places, columns, _ in parts:
            spread[np.ix_(places, places)] += _correlated(_of_groups(columns, groups), shared)
        inverse = scaled_inverse(normal)
        return inverse @ spread @ inverse


def striped(residual: FloatArray) -> float:
    """Estimate the variance that cells of (views, cells) have in all views alike, by differences of neighbours."""
    views, steps = len(residual), np.diff(residual, axis=1)
    usual = robust_deviation(steps - np.median(steps))
    kept = (np.abs(steps) < 5.0 * usual).all(axis=0)
    if views < 2 or kept.sum() < LAGS:
        return 0.0
    products = (steps.sum(axis=0) ** 2 - (steps**2).sum(axis=0))[kept] / (views * (views - 1))
    return max(0.5 * float(products.mean()), 0.0)


def _of_groups(rows: FloatArray, groups: int) -> FloatArray:
    """Return the sums over the groups of a passage's rows, with the noise of one sample."""
    *first, views, cells = rows.shape
    return np.asarray(rows.reshape(*first, views // groups, groups, cells).sum(axis=-2) / math.sqrt(groups))


def correlation(residuals: Sequence[FloatArray]) -> FloatArray:
    """Return what cells at distances of 0 to `LAGS` share beyond white noise, (lags + 1,), tapered by Bartlett."""
    size = sum(one.size for one in residuals)
    power = [
        sum(float((one[:, lag:] * one[:, : one.shape[1] - lag]).sum()) for one in residuals) for lag in range(LAGS + 1)
    ]
    shared = np.array(power) / size
    shared[0] = max(shared[0] - 1.0, 0.0)
    return np.asarray(shared * (1.0 - np.arange(LAGS + 1) / (LAGS + 1)))


def _correlated(columns: FloatArray, shared: FloatArray) -> FloatArray:
    """Return what correlation adds to the products of columns (n, views, cells)."""
    taps = np.concatenate([shared[:0:-1], shared])
    smooth = scipy.ndimage.correlate1d(columns, taps, axis=2, mode="constant")
    product = smooth.reshape(len(columns), -1) @ columns.reshape(len(columns), -1).T
    return np.asarray(0.5 * (product + product.T))


def corners_of(board: Phantom) -> int:
    """Return the number of coordinates of corners that are fitted: 0 for drawings with too many."""
    count = 2 * sum(map(len, map(_points, board.shapes)))
    return count if count <= 2 * MOST_CORNERS else 0


def _points(shape: Shape) -> FloatArray:
    """Return the corners of a shape, or the middle of a disc, (points, 2)."""
    return np.array([shape.center_mm] if isinstance(shape, Disc) else shape.vertices_mm)


def with_corners(board: Phantom, moved: FloatArray) -> Phantom:
    """Return the drawing with its corners, and the middles of its discs, moved by these coordinates, mm."""
    if not moved.any():
        return board
    shapes, left = list[Shape](), moved.reshape(-1, 2)
    for shape in board.shapes:
        points = _points(shape)
        corners = [(float(x), float(y)) for x, y in points + left[: len(points)]]
        left = left[len(points) :]
        places = {"center_mm": corners[0]} if isinstance(shape, Disc) else {"vertices_mm": tuple(corners)}
        shapes.append(replace(shape, **places))
    return replace(board, shapes=tuple(shapes))
