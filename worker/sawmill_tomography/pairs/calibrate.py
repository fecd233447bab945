"""The calibration of a scanner of fixed pairs from passages of one board."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations

import numpy as np

from sawmill_tomography.calibration.joint_fit.wood_patches import Variation
from sawmill_tomography.calibration.judgement import Degree, Remark, combined
from sawmill_tomography.calibration.sinogram_data import counted_radius_mm
from sawmill_tomography.geometry.geometry import TAU, FloatArray, GeometryError, SourceFrame, rotate, to_vector
from sawmill_tomography.pairs.coarse import Nominal, Placed, likely, restarted, starts, together
from sawmill_tomography.pairs.fine import FRAMES, OF_FAN, SLOPES, SWING_MM, WOOD, FineFit
from sawmill_tomography.pairs.passages import PairData, moved_frames
from sawmill_tomography.pairs.ray_errors import PairRays, PredictedRays, rigid_motion
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.statistics import TWO_SIDED_95, robust_deviation
from sawmill_vocabulary import CellOrder, PairedScanner, Progress, ProgressCallback, Verdict, angle_difference
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.pair_messages import PairMessage

# Cells that are combined in the search for the poses, and in the first fit of all.
COARSE, MIDDLE = 16, 4
# Where the combined cells differ by less than this number of standard deviations of neighbouring cells is no board.
LEAST_SHADOW = 5.0
# A drawn corner's standard deviation where it is not stated, mm.
CORNER_MM = 0.3
# The order of the cells is certain beyond this number of standard deviations; places are suspect beyond the second, and
# those of something else beyond the third.
CERTAIN, FAR, ELSEWHERE = 5.0, 4.0, 12.0
# A board that slants by more is not told from one that moves sideways, and its cross-section is longer by 1 / cos.
SLANTED_DEG = 3.0
# The board has moved while it was fed where twice the logarithm of the likelihood ratio is larger: by chance in 0.1 %.
SWINGS = 10.0
# Rolls that differ by less count as alike, degrees; a share of the shadow above this is no fit.
ALIKE_DEG, NO_FIT = 15.0, 0.05
# Where a start leaves more of the shadow, the board's other side is tried; it is right where it leaves half as much.
SUSPECT, OTHER = 0.025, 0.5
# Means over thirds of the rows lie within this part of them.
OF_ROWS = 2.0 / 3.0


@dataclass(frozen=True, eq=False)
class PairsTask:
    """What a calibration of fixed pairs is made from."""

    scanner: PairedScanner
    board: Phantom  # the drawing, from the side that is seen
    data: Sequence[PairData]  # of each pair, with the cells in the order of the file
    from_counts: bool = True
    corner_mm: float = CORNER_MM
    tolerance_mm: float = 0.1
    scale_tolerance_percent: float = 0.5
    radius_mm: float | None = None  # of the disc in which ray errors count; None: the board's, at most 150 mm


@dataclass(frozen=True)
class FoundPair:
    """The geometry of one pair in the common frame, which is the one nearest to all nominal places."""

    frame: SourceFrame
    deviations: tuple[float, ...]  # of (psi, R, SDD, u_c, tau)
    rays: PredictedRays
    cell_order: CellOrder
    order_deviations: float | None  # by which the other order is worse; None where the order was stated


@dataclass(frozen=True)
class FoundPairs:
    """The calibration of a scanner of fixed pairs."""

    pairs: tuple[FoundPair, ...]
    rays: PredictedRays  # of all pairs, after the common rigid motion and scale
    scale_percent_95: float
    poses: tuple[tuple[float, float, float], ...]  # x, y in mm and roll in rad of the board's middle in each passage
    corners_mm: float  # RMS by which coordinates of the drawing's corners are off
    left_share: float  # RMS of the residual as a share of the shadow's
    radius_mm: float
    verdict: Verdict
    reasons: tuple[Reason, ...]


def calibrate_pairs(task: PairsTask, *, on_progress: ProgressCallback = lambda _: None, seed: int = 1) -> FoundPairs:
    """Find the geometry of all pairs from passages of one board, whose poses are not known.

    Parameters
    ----------
    task : PairsTask
        The nominal places, the drawing and the line integrals.
    seed : int
        Seed of the restarts.

    Returns
    -------
    FoundPairs
        Frames in the common frame, bounds of the rays, the scale, and the verdict. docs/do/fixed-pairs.md says what
        each means.

    Raises
    ------
    GeometryError
        A pair sees nothing of the board, or no start leads to a geometry in front of all sources.
    """
    _check(task)
    board, nominal = task.board.centred(), _nominal(task.scanner)
    on_progress(Progress(fraction=0.05, stage="start"))
    orders, several = _ordered(board, task, nominal)
    if orders.left_share > SUSPECT:
        other, _ = _ordered(board.mirrored(), task, nominal)
        orders = replace(orders, other_share=other.left_share)
    on_progress(Progress(fraction=0.3, stage="fit"))
    fit, swings, converged = _fitted(board, _in_order(task.data, orders.reversed), several, nominal, task, seed)
    on_progress(Progress(fraction=0.9, stage="bounds"))
    covariance = fit.covariance()[fit.layout.part(FRAMES), fit.layout.part(FRAMES)]
    return _found(task, board, fit, covariance, nominal, orders, swings, converged=converged)


def _check(task: PairsTask) -> None:
    """Refuse pairs with few cells, and pairs that see nothing."""
    for number, one in enumerate(task.data, 1):
        if (cells := one.lines.shape[-1]) < 2 * COARSE:
            raise GeometryError(f"pair {number} has {cells} cells, and at least {2 * COARSE} are needed")
        if not np.ptp(one.binned(COARSE).lines, axis=-1).min() > LEAST_SHADOW * robust_deviation(np.diff(one.lines)):
            raise GeometryError(f"pair {number} sees nothing of the board in one of its passages")


def _nominal(scanner: PairedScanner) -> Nominal:
    """Return the nominal places; what they may be off by is two standard deviations."""
    within = np.array([(math.radians(pair.angle_within_deg), pair.place_within_mm) for pair in scanner.pairs])
    return Nominal(np.array([to_vector(pair.frame) for pair in scanner.pairs]), 0.5 * within[:, [0, 1, 1, 1, 0]])


@dataclass(frozen=True)
class _Orders:
    """Which pairs' cells were read backwards, and by how many standard deviations the other order is worse."""

    reversed: tuple[bool, ...]
    deviations: Sequence[float | None]
    left_share: float  # share of the shadow that the start leaves, and that it leaves of the board from its other side
    other_share: float = math.inf


def _ordered(board: Phantom, task: PairsTask, nominal: Nominal) -> tuple[_Orders, list[Placed]]:
    """Find the order of the cells where it is not stated, and starts of the fit with it, the best first."""
    coarse = [one.binned(COARSE) for one in task.data]
    unknown = [number for number, pair in enumerate(task.scanner.pairs) if pair.cell_order is None]
    stated = tuple(pair.cell_order is CellOrder.COUNTER_CLOCKWISE for pair in task.scanner.pairs)

    @cache
    def fitted(turned: tuple[bool, ...]) -> list[Placed]:
        return starts(board, _in_order(coarse, turned), nominal)

    best = stated
    for several in (1, 2):
        improved = True
        while improved:
            others = (_flipped(best, places) for places in combinations(unknown, several))
            here = min([best, *others], key=lambda turned: fitted(turned)[0].power)
            improved, best = here != best, here
        if several == 1 and _share_left(coarse, fitted(best)[0]) < NO_FIT:
            break
    start = fitted(best)[0]
    unit = start.power / max(sum(one.lines.size for one in coarse) - start.frames.size, 1)
    worse = {number: fitted(_flipped(best, (number,)))[0].power - start.power for number in unknown}
    deviations = [math.sqrt(max(worse[at], 0.0) / unit) if at in worse else None for at in range(len(best))]
    return _Orders(best, deviations, _share_left(coarse, start)), fitted(best)


def _in_order(data: Sequence[PairData], turned: Sequence[bool]) -> list[PairData]:
    return [one.reversed if back else one for one, back in zip(data, turned, strict=True)]


def _flipped(turned: tuple[bool, ...], places: Sequence[int]) -> tuple[bool, ...]:
    return tuple(back != (number in places) for number, back in enumerate(turned))


def _share_left(data: Sequence[PairData], placed: Placed) -> float:
    return math.sqrt(placed.power / sum(one.shadow_power for one in data))


def _fitted(
    board: Phantom, data: list[PairData], several: list[Placed], nominal: Nominal, task: PairsTask, seed: int
) -> tuple[FineFit, Variation, bool]:
    """Fit all unknowns, first on some cells together, from each start that may be the right one."""
    middle, rng = [one.binned(MIDDLE) for one in data], np.random.default_rng(seed)
    fits = []
    for start in likely(several):
        placed = restarted(board, middle, together(board, middle, start, nominal), nominal, rng)
        fits.append(FineFit(board, middle, placed, from_counts=task.from_counts, corner_mm=task.corner_mm))
        fits[-1].settle()
    # Each fit has measured its own noise: they are compared by the same.
    fit = min(fits, key=lambda one: one.power(one.x, fits[0]))
    fit = fit.of_rows(data)
    fit.solve()
    fit.weigh()
    fit.vary_fans_and_densities()
    fit.solve()
    fit.let_knots_differ()
    fit.solve()
    fit.temper()
    fit.solve()
    return fit, fit.let_swing(apart=len({pair.feed_offset_mm for pair in task.scanner.pairs}) > 1), fit.solve()


def _found(
    task: PairsTask,
    board: Phantom,
    fit: FineFit,
    covariance: FloatArray,
    nominal: Nominal,
    orders: _Orders,
    swings: Variation,
    *,
    converged: bool,
) -> FoundPairs:
    """Move the answer into the common frame, and judge it."""
    scanners = [pair.scanner for pair in task.scanner.pairs]
    radius = counted_radius_mm(task.radius_mm, board)
    motion = rigid_motion(PairRays(scanners, nominal.frames, radius), fit.placed.frames)
    rays = PairRays(scanners, moved_frames(fit.placed.frames, motion.tolist()), radius)
    covariance = rays.without_motion(covariance, motion, fit.placed.frames)
    deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0)).reshape(-1, 5)
    turned = [CellOrder.COUNTER_CLOCKWISE if back else CellOrder.CLOCKWISE for back in orders.reversed]
    pairs = tuple(
        FoundPair(
            SourceFrame.from_vector(rays.frames[number]),
            tuple(deviations[number].tolist()),
            rays.predicted(covariance, number),
            turned[number],
            orders.deviations[number],
        )
        for number in range(len(scanners))
    )
    x, y = rotate(motion[2], *fit.placed.poses[:, :2].T) + motion[:2, None]
    corners_mm = fit.off_drawing_mm()
    # A board that is further off its drawing than stated is no better a ruler; of two lengths that do not go together
    # either may be the right one.
    worse, half = max(1.0, corners_mm / task.corner_mm), 0.5 * abs(float(fit.x[fit.layout.part(WOOD)][0]))
    scale = worse * math.hypot(rays.scale_deviation(covariance), board.size_tolerance)
    found = FoundPairs(
        pairs,
        rays.predicted(covariance),
        100.0 * (TWO_SIDED_95 * scale + half),
        tuple(zip(x.tolist(), y.tolist(), np.mod(fit.placed.poses[:, 2] + motion[2], TAU).tolist(), strict=True)),
        corners_mm,
        fit.share_left(),
        radius,
        "pass",
        (),
    )
    slants_deg = np.degrees(np.hypot(*fit.x[fit.layout.part(SLOPES)].reshape(-1, 3)[:, :2].T))
    judgement = combined([*_remarks(task, found, nominal, orders, swings, slants_deg, converged=converged)])
    return replace(found, verdict=judgement.verdict, reasons=judgement.reasons)


def _misfits(found: FoundPairs, orders: _Orders) -> Iterator[Remark]:
    """Say where the passages do not fit the drawing from this side."""
    if found.left_share > NO_FIT:
        shares = {"left_percent": 100.0 * found.left_share, "allowed_percent": 100.0 * NO_FIT}
        yield Remark(Degree.FAIL, PairMessage.NO_FIT(**shares))
    if orders.other_share < OTHER * orders.left_share:
        sides = {"other_percent": 100.0 * orders.other_share, "left_percent": 100.0 * orders.left_share}
        yield Remark(Degree.FAIL, PairMessage.OTHER_SIDE(**sides))


def _remarks(
    task: PairsTask,
    found: FoundPairs,
    nominal: Nominal,
    orders: _Orders,
    swings: Variation,
    slants_deg: FloatArray,
    *,
    converged: bool,
) -> Iterator[Remark]:
    """Say what is wrong or uncertain, with the verdict that follows."""
    if misfits := [*_misfits(found, orders)]:
        yield from misfits
        return
    if not converged:
        yield Remark(Degree.FAIL, PairMessage.NOT_CONVERGED())
    middles, rows_mm = [one.heights_mm.mean() for one in task.data], np.ptp(task.data[0].heights_mm) / OF_ROWS
    if np.ptp(middles) > max(rows_mm, OF_FAN[0]):
        yield Remark(Degree.WATCH, PairMessage.APART(apart_mm=float(np.ptp(middles)), rows_mm=float(rows_mm)))
    for passage, slant_deg in enumerate(slants_deg.tolist(), 1):
        if slant_deg > SLANTED_DEG:
            slants = {"passage": passage, "slant_deg": slant_deg, "allowed_deg": SLANTED_DEG}
            yield Remark(Degree.WATCH, PairMessage.SLANTS(**slants))
    yield from _imprecise(task, found, swings)
    for number, (pair, expected) in enumerate(zip(found.pairs, nominal.frames, strict=True), 1):
        if pair.order_deviations is not None and pair.order_deviations < CERTAIN:
            yield Remark(Degree.WATCH, PairMessage.ORDER_UNCERTAIN(pair=number, deviations=pair.order_deviations))
        elif pair.cell_order is CellOrder.COUNTER_CLOCKWISE and pair.order_deviations is not None:
            yield Remark(Degree.NOTE, PairMessage.BACKWARDS(pair=number, deviations=pair.order_deviations))
        off = to_vector(pair.frame) - expected
        off[[0, 4]] = np.angle(np.exp(1j * off[[0, 4]]))
        if (farthest := float((np.abs(off) / nominal.deviations[number - 1]).max())) > FAR:
            degree = Degree.FAIL if farthest > ELSEWHERE else Degree.WATCH
            yield Remark(degree, PairMessage.FAR_AWAY(pair=number, deviations=farthest))


def _imprecise(task: PairsTask, found: FoundPairs, swings: Variation) -> Iterator[Remark]:
    """Say what makes rays or sizes too uncertain."""
    if swings.likelihood > SWINGS:
        yield Remark(Degree.WATCH, PairMessage.SWINGS(swing_mm=SWING_MM * swings.deviation))
    elif found.rays.upper_95_mm > task.tolerance_mm:
        sizes = {"rms_mm": found.rays.rms_mm, "upper_mm": found.rays.upper_95_mm, "allowed_mm": task.tolerance_mm}
        yield Remark(Degree.WATCH, PairMessage.ROLL_AGAIN(passages=len(found.poses), **sizes))
        for (first, one), (second, other) in combinations(enumerate(found.poses, 1), 2):
            if (apart_deg := abs(math.degrees(angle_difference(one[2], other[2])))) < ALIKE_DEG:
                yield Remark(Degree.WATCH, PairMessage.LIES_ALIKE(first=first, second=second, apart_deg=apart_deg))
    if found.scale_percent_95 > task.scale_tolerance_percent:
        allowed = {"allowed_percent": task.scale_tolerance_percent, "corners_mm": found.corners_mm}
        yield Remark(Degree.WATCH, PairMessage.SCALE(percent=found.scale_percent_95, **allowed))
