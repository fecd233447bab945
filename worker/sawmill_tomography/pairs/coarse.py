"""Fits on combined cells: a board's poses where nothing is known of them, and pairs and poses together.

Gain and offset of each view are projected out (variable projection, Golub and Pereyra 2003).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from sawmill_tomography.geometry.fit_parameters import GramTerm
from sawmill_tomography.geometry.geometry import TAU, FloatArray, SourceFrame, rotate
from sawmill_tomography.pairs.passages import PairData, by_pose, seen_by_views
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection import analytic

# Rolls from which the search for a board's pose starts; starts of a passage, and of all together, that are kept.
ROLLS, KEPT, TOGETHER = 36, 5, 8
POSE_STEPS, STEPS = 12, 40
# A fit ends where a step lowers the power of the residual by less than this share.
CONVERGED = 1e-5
_LINEAR = [GramTerm.SHADOW, GramTerm.ONE]
_OTHERS = [*range(7), GramTerm.DATA]
# Sizes of moves from which a fit starts again: of the nominal places' standard deviations, and of a pose, mm and rad.
KICKS, POSE_KICK = (0.1, 0.3, 0.6), np.array([20.0, 20.0, 0.1])
# Starts with up to this times the least power may be right; the best ones are followed.
NEARLY, MOST = 2.0, 3
# Where two poses are nearer than this, one is the other: mm and rad.
SAME_MM, SAME_RAD = 3.0, 0.02


@dataclass(frozen=True, eq=False)
class Placed:
    """Places of the pairs and poses of the board that were fitted, and how well they explain the data."""

    frames: FloatArray  # (pairs, 5) rows (psi, R, SDD, u_c, tau)
    poses: FloatArray  # (passages, 3) rows (x, y, roll), mm and rad
    power: float  # sum of squares of the residual, and of the departure from the nominal places in its unit


def reduced_grams(
    board: Phantom, data: PairData, frame: FloatArray, poses: FloatArray, lines: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return each view's normal matrix (views, 8, 8), score (views, 8) and residual power (views,).

    The unknowns are the frame's five, then the pose's three. `lines` (views, cells); gain and offset are projected out.
    """
    angles, positions = seen_by_views(poses)
    grams = analytic.gram(board, data.cells, SourceFrame.from_vector(frame), angles, lines, position_mm=positions)
    linear, cross = grams[:, _LINEAR][:, :, _LINEAR], grams[:, _LINEAR][:, :, _OTHERS]
    linear = linear + 1e-12 * np.trace(linear, axis1=1, axis2=2)[:, None, None] * np.eye(2)
    solved = np.linalg.solve(linear, cross)
    left = grams[:, _OTHERS][:, :, _OTHERS] - np.swapaxes(cross, 1, 2) @ solved
    gain = solved[:, 0, -1]
    chain = np.zeros((len(poses), 8, 7))
    chain[:, :5, :5] = np.eye(5)
    units = np.eye(7)[:, None]
    # Derivatives by the pose as combinations of the seven.
    pose = by_pose(poses, np.repeat(units[0], len(poses), 0), np.repeat(units[5:], len(poses), 1))
    chain[:, 5:] = np.swapaxes(pose, 0, 1)
    normal = gain[:, None, None] ** 2 * (chain @ left[:, :7, :7] @ np.swapaxes(chain, 1, 2))
    score = gain[:, None] * (chain @ left[:, :7, -1:])[..., 0]
    return normal, score, np.maximum(left[:, -1, -1], 0.0)


def poses_alone(board: Phantom, data: Sequence[PairData], frames: FloatArray) -> list[list[tuple[float, FloatArray]]]:
    """Find each passage's likely poses next to these places of the pairs, the best first: (power, pose (3,))."""
    passages = len(data[0].lines)
    rolls = np.tile(np.arange(ROLLS) * TAU / ROLLS, passages)
    lines = [np.repeat(one.lines[:, 0], ROLLS, axis=0) for one in data]
    middles = np.repeat(_middles(data, frames), ROLLS, axis=0)
    poses = np.column_stack([middles - np.stack(rotate(rolls, *board.centroid_mm), -1), rolls])
    damping = np.full(rolls.size, 1e-2)

    def system(at: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        parts = [reduced_grams(board, *each[:2], at, each[2]) for each in zip(data, frames, lines, strict=True)]
        normal, score, power = (sum(each) for each in zip(*parts, strict=True))
        return normal[:, 5:, 5:], score[:, 5:], power

    normal, score, power = system(poses)
    for _ in range(POSE_STEPS):
        diagonal = np.einsum("vii->vi", normal)
        damped = normal + (damping[:, None] * diagonal)[:, :, None] * np.eye(3) + 1e-12 * np.eye(3)
        step = np.linalg.solve(damped, score[..., None])[..., 0]
        step *= np.minimum(1.0, 40.0 / np.maximum(np.hypot(*step[:, :2].T), 1e-9))[:, None]
        there = system(poses + step)
        better = there[2] < power
        poses[better] += step[better]
        damping = np.where(better, 0.3 * damping, 5.0 * damping)
        normal[better], score[better], power[better] = (each[better] for each in there)
    return [_distinct(power[own], poses[own]) for own in np.split(np.arange(rolls.size), passages)]


def _middles(data: Sequence[PairData], frames: FloatArray) -> FloatArray:
    """Return the point (passages, 2) that is nearest to the rays through the middles of the shadows."""
    normals, offsets = [], []
    for one, frame in zip(data, frames, strict=True):
        lines = np.maximum(one.lines[:, 0] - np.median(np.sort(one.lines[:, 0], axis=1)[:, :4], axis=1)[:, None], 0.0)
        u = one.cells.first_border_mm + (np.arange(one.cells.count) + 0.5) * one.cells.width_mm
        middle = (lines @ u) / np.maximum(lines.sum(axis=1), 1e-300)
        psi, r, sdd, u_c, tau = frame
        w = middle - u_c
        angle = psi + np.arctan2(sdd + w * np.sin(tau), w * np.cos(tau))
        normal = np.stack([-np.sin(angle), np.cos(angle)], -1)
        normals.append(normal)
        offsets.append(normal @ np.array([r * np.sin(psi), -r * np.cos(psi)]))
    a, b = np.stack(normals, 1), np.stack(offsets, 1)
    return np.linalg.solve(np.swapaxes(a, 1, 2) @ a, np.swapaxes(a, 1, 2) @ b[..., None])[..., 0]


def _distinct(power: FloatArray, poses: FloatArray) -> list[tuple[float, FloatArray]]:
    kept: list[tuple[float, FloatArray]] = []
    for number in np.argsort(power):
        off = [poses[number] - other for _, other in kept]
        if all(np.hypot(x, y) > SAME_MM or abs(np.sin(0.5 * roll)) > SAME_RAD for x, y, roll in off):
            kept.append((float(power[number]), poses[number]))
    return kept[:KEPT]


@dataclass(frozen=True, eq=False)
class Nominal:
    """Where the pairs should be, and the standard deviations of their true places about it."""

    frames: FloatArray  # (pairs, 5)
    deviations: FloatArray  # (pairs, 5)


def together(board: Phantom, data: Sequence[PairData], start: Placed, nominal: Nominal) -> Placed:
    """Fit pairs and poses together, with the nominal places as prior."""
    pairs, passages = len(data), len(start.poses)
    size = 5 * pairs + 3 * passages
    poses_at = 5 * pairs + 3 * np.arange(passages)[:, None] + np.arange(3)
    samples = sum(one.lines.size for one in data)
    precision = np.concatenate([(1.0 / nominal.deviations**2).ravel(), np.zeros(3 * passages)])

    def system(at: Placed) -> tuple[FloatArray, FloatArray, float]:
        normal, score, power = np.zeros((size, size)), np.zeros(size), 0.0
        for number, (one, frame) in enumerate(zip(data, at.frames, strict=True)):
            own, by, left = reduced_grams(board, one, frame, at.poses, one.lines[:, 0])
            power += float(left.sum())
            for passage, places in enumerate(poses_at):
                both = np.append(np.arange(5 * number, 5 * number + 5), places)
                normal[np.ix_(both, both)] += own[passage]
                score[both] += by[passage]
        return normal, score, power

    at, damping = start, 1e-3
    normal, score, power = system(at)

    def drawn(placed: Placed, unit: float) -> float:
        return float(unit * (((placed.frames - nominal.frames) / nominal.deviations) ** 2).sum())

    for _ in range(STEPS):
        unit = power / max(samples - size, 1)
        departure = np.append((at.frames - nominal.frames).ravel(), np.zeros(3 * passages))
        prior = unit * precision
        whole = normal + np.diag(prior)
        pull = score - prior * departure
        scale = 1.0 / np.sqrt(np.maximum(np.diag(whole), 1e-300))
        scaled = whole * np.outer(scale, scale)
        before = power + drawn(at, unit)
        for _ in range(6):
            change = scale * np.linalg.solve(scaled + damping * np.eye(size), scale * pull)
            there = Placed(
                at.frames + change[: 5 * pairs].reshape(pairs, 5), at.poses + change[5 * pairs :].reshape(-1, 3), 0.0
            )
            found = system(there) if possible(board, there) else None
            if found is not None and found[2] + drawn(there, unit) < before:
                break
            damping *= 8.0
        else:
            break
        at, (normal, score, power), damping = there, found, max(0.2 * damping, 1e-9)
        if before - power - drawn(at, unit) < CONVERGED * before:
            break
    return replace(at, power=power + drawn(at, power / max(samples - size, 1)))


def possible(board: Phantom, placed: Placed) -> bool:
    """Return whether the frames exist and the board stays clear of all sources."""
    reach = board.radius_mm + float(np.hypot(*placed.poses[:, :2].T).max())
    _, r, sdd, _, tau = placed.frames.T
    return bool(
        np.isfinite(placed.frames).all()
        and (np.abs(tau) < 1.3).all()
        and (r < sdd).all()
        and (r * np.cos(tau) > 1.05 * reach).all()
    )


def starts(board: Phantom, data: Sequence[PairData], nominal: Nominal) -> list[Placed]:
    """Return starts of a fit of all, from nothing known of the poses, the best first."""
    alone = poses_alone(board, data, nominal.frames)
    sets = sorted(
        ((sum(power for power, _ in several), np.stack([pose for _, pose in several])) for several in product(*alone)),
        key=lambda each: each[0],
    )
    fitted = [together(board, data, Placed(nominal.frames, poses, power), nominal) for power, poses in sets[:TOGETHER]]
    return sorted(fitted, key=lambda each: each.power)


def likely(several: Sequence[Placed]) -> list[Placed]:
    """Return the starts, the best first, that explain the data nearly as well and lead elsewhere."""
    chosen: list[Placed] = []
    for placed in several:
        apart = [np.abs(placed.frames - other.frames)[:, 1:4].max() > SAME_MM for other in chosen]
        if placed.power < NEARLY * several[0].power and all(apart):
            chosen.append(placed)
    return chosen[:MOST]


def restarted(
    board: Phantom, data: Sequence[PairData], placed: Placed, nominal: Nominal, rng: np.random.Generator
) -> Placed:
    """Return the best of some fits from places near this one, which a fit that stalled would leave."""
    found = [placed]
    for size in KICKS:
        frames = placed.frames + size * nominal.deviations * rng.standard_normal(placed.frames.shape)
        poses = placed.poses + size * POSE_KICK * rng.standard_normal(placed.poses.shape)
        if possible(board, near := Placed(frames, poses, 0.0)):
            found.append(together(board, data, near, nominal))
    return min(found, key=lambda each: each.power)
