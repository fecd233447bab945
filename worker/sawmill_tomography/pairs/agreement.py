"""Whether fixed pairs still agree, by the marks of one log and the middles of the log's shadows."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.pairs.log_pictures import LogPictures
from sawmill_tomography.pairs.marks import MISSED, Sights, bend
from sawmill_tomography.statistics import TWO_SIDED_95, exceeded_chi_square
from sawmill_vocabulary.pairs import PairAgreement

# How well the middles of shadows agree where nothing has moved: scattered radiation and hardening move them
# (benchmarks/pair_logs.py). Marks on rays that moved by about this much are still found to belong together.
SHADOWS_MM, MOVED_MM = 0.5, 3.0
# What all marks of a pair may be off alike, mm, so that many marks do not make small errors significant.
COMMON_MM = 0.15
# A pair is named if its motion alone leaves less than this share of the chi-square that any other one leaves.
EXPLAINED = 0.25
# Steps in which the middle of the shadows settles to a micrometre.
STEPS = 4


class _Meeting(NamedTuple):
    """Rays that meet in an unknown point: information (pairs, pairs) on the shifts of all pairs, and distances."""

    information: FloatArray
    distances_mm: FloatArray  # (pairs,): of the rays from the centre; 0 where a pair has none
    freedom: int


def shadow_middles(pictures: LogPictures) -> tuple[FloatArray, FloatArray]:
    """Return the ray of each pair through the log's centre of mass: normals (pairs, 2), distances (pairs,) mm.

    With p across and a along the ray to a point at the depth t, the integral of a shadow P(angle) tan^n / cos is the
    integral of the attenuation times p^n / (t + a)^(n + 1), exactly. The means of p^2 give the means of p a.
    """
    profiles, views, centre = pictures.lines.mean(axis=1), pictures.views, np.zeros(2)
    for _ in range(STEPS):
        depths = np.hypot(*(centre - views.source_mm).T)
        along = (centre - views.source_mm) / depths[:, None]
        normals = np.stack([along[:, 1], -along[:, 0]], -1)
        rays = pictures.cells_mm[:, None] * views.axis[:, None] - views.source_mm[:, None]
        tangents = np.einsum("pmc,pc->pm", rays, normals) / np.einsum("pmc,pc->pm", rays, along)
        weights = profiles * np.sqrt(1.0 + tangents**2) * np.gradient(np.arctan(tangents), axis=1)
        first, second = (depths**n * (weights * tangents**n).sum(axis=1) / weights.sum(axis=1) for n in (1, 2))
        distances = normals @ centre + first + 2.0 * bend(normals, second) / depths
        centre = np.linalg.lstsq(normals, distances)[0]
    return normals, distances


def agreement(sights: Sights, tolerance_mm: float) -> PairAgreement:
    """Estimate how far the rays of each pair have moved against all others, from points in which they meet.

    The pairs agree where no pair's motion can exceed `tolerance_mm`, with 95 %.
    """
    count = len(sights.marks)
    if count == 2:  # rays of two pairs always meet
        return PairAgreement("unknown")
    middles = _meeting(*shadow_middles(sights.pictures), SHADOWS_MM, range(count), count)
    still, loose = (
        [
            _meeting(body.normals, body.distances_mm, sights.middle_mm, [*body.marks], count)
            for body in sights.bodies(moved_mm)
            if not body.is_ambiguous
        ]
        for moved_mm in (0.0, MOVED_MM)
    )
    # A wrong set of marks fits no motion that others show: the motion, or none, that the most rays agree on counts.
    motions = [_shifts([middles, each])[0] for each in loose]
    agreeing = [[one for one in loose if _fits(one, motion)] for motion in motions if _fits(middles, motion)]
    used = max([still, *agreeing], key=lambda marks: sum(one.freedom for one in marks))
    shifts, covariance, seen = _shifts([middles, *used])
    common = sights.ray_errors_mm**2 + COMMON_MM**2
    information = np.linalg.pinv(covariance + seen * common @ seen.T, rcond=1e-9)
    own = np.diag(information)
    moved, within = information @ shifts / own, TWO_SIDED_95 / np.sqrt(own)
    chi_square = float(shifts @ information @ shifts)
    left, shown = chi_square - own * moved**2, ((*moved.tolist(),), (*within.tolist(),))
    if chi_square > exceeded_chi_square(MISSED, count - 2):
        best, next_best = np.sort(left)[:2]
        alone = count > 3 and best < EXPLAINED * next_best
        return PairAgreement("disagree", *shown, int(left.argmin()) + 1 if alone else None)
    return PairAgreement("agree" if (np.abs(moved) + within).max() <= tolerance_mm else "unknown", *shown)


def _meeting(normals: FloatArray, distances: FloatArray, known_mm: float, pairs: Sequence[int], count: int) -> _Meeting:
    """Take the unknown point out of rays (rays,) of some pairs that are known to this standard deviation."""
    of_all, own = np.eye(count)[:, pairs], np.eye(len(pairs)) - normals @ np.linalg.pinv(normals)
    return _Meeting(of_all @ own @ of_all.T / known_mm**2, of_all @ distances, len(pairs) - 2)


def _fits(meeting: _Meeting, shifts: FloatArray) -> bool:
    off = meeting.distances_mm - shifts
    return bool(off @ meeting.information @ off < exceeded_chi_square(MISSED, meeting.freedom))


def _shifts(meetings: Sequence[_Meeting]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the least shifts of all pairs, their covariance, and the projector on what the rays show of shifts."""
    information = np.sum([one.information for one in meetings], axis=0)
    covariance = np.linalg.pinv(information, rcond=1e-9)
    return (
        covariance @ np.sum([m.information @ m.distances_mm for m in meetings], axis=0),
        covariance,
        covariance @ information,
    )
