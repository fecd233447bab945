"""Motions that are too small for a scan to show, and that still move the geometry of the fit.

A motion that chance explains is not fitted. If it is real, the fitted columns take up a part of it. The ray error's
bound counts each motion with its likelihood (docs/understand/verdict.md#ray-error).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sawmill_tomography.calibration.joint_fit.readings import Fitted
from sawmill_tomography.calibration.joint_fit.scan_model import Term
from sawmill_tomography.calibration.joint_fit.selection import EffectTester
from sawmill_tomography.geometry.geometry import FloatArray

# Sizes of hidden motions at the phantom's rim (standard deviations of each unknown, mm): every order of magnitude is
# as likely. Larger ones show, but for a scan of very few views.
SIZES_MM = np.geomspace(0.03, 0.3, 4)
# How much likelier beforehand a scan hides a motion of one of these sizes than none (benchmarks/families.py).
ODDS = 4.0
# Motions with a smaller probability are left out.
LEAST_PROBABILITY = 1e-4


@dataclass(frozen=True, eq=False)
class HiddenMotions:
    """Motions that a scan may hide, each of one order of magnitude; at most one is real."""

    probabilities: FloatArray  # (n,)
    biases: FloatArray  # (n, used)
    spreads: FloatArray  # (n, used, unknowns)


@dataclass(frozen=True, eq=False)
class MotionKind:
    """Motions of one kind, which a scan may hide."""

    tester: EffectTester  # the test of the motions' columns
    motions: Sequence[Fitted]  # the motion at each place where it may begin, with as many columns each
    variance: float  # the variance of a sample that chance gives to the motions' scores


def hidden_motions(kinds: Sequence[MotionKind], radius_mm: float) -> HiddenMotions | None:
    """Find the motions that a scan may hide; None where it hides none.

    Each kind is as likely beforehand, and each place where a motion of a kind may begin. The sizes of a motion's
    columns are independent normal variables; the marginal likelihood of a motion follows from its score. `radius_mm`
    is the phantom's radius: a turn moves the rim by it.
    """
    alike: dict[tuple[EffectTester, int], list[tuple[Fitted, float, float]]] = {}
    for kind in kinds:
        prior = ODDS / (len(kinds) * len(kind.motions) * SIZES_MM.size)
        group = alike.setdefault((kind.tester, len(kind.motions[0].columns)), [])
        group += [(one, kind.variance, prior) for one in kind.motions]
    widest = max((width for _, width in alike), default=0)
    cases = [_cases(tester, some, radius_mm, widest) for (tester, _), some in alike.items()]
    if not cases:
        return None
    evidence, biases, spreads = (np.concatenate(parts) for parts in zip(*cases, strict=True))
    largest = max(float(evidence.max()), 0.0)
    weights = np.exp(evidence - largest)
    probabilities = weights / (weights.sum() + np.exp(-largest))
    kept = probabilities > LEAST_PROBABILITY
    return HiddenMotions(probabilities[kept], biases[kept], spreads[kept]) if kept.any() else None


def _cases(
    tester: EffectTester, group: Sequence[tuple[Fitted, float, float]], radius_mm: float, widest: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the logarithm of prior times likelihood, biases and spreads of motions with as many columns each."""
    motions, variances, priors = zip(*group, strict=True)
    left, variance = tester.left(np.array([one.places for one in motions])), np.array(variances)[:, None]
    # Independent unknowns of unit deviation: their information, score, and effect on the fitted columns.
    unit = np.array([[1.0 / radius_mm if c.parts[0][0] is Term.PSI else 1.0 for c in one.columns] for one in motions])
    values, vectors = np.linalg.eigh(left.normal * unit[:, :, None] * unit[:, None] / variance[..., None])
    turned = unit[..., None] * vectors
    score, moved = (left.score[:, None] @ turned)[:, 0] / variance, left.sensitivity @ turned
    square = SIZES_MM[:, None, None] ** 2
    shrunk = square / (1.0 + square * np.maximum(values, 0.0))
    evidence = 0.5 * (np.log(shrunk / square) + shrunk * score**2).sum(axis=-1)
    evidence += np.log(priors)
    spreads = np.zeros((*shrunk.shape[:2], moved.shape[1], widest))
    spreads[..., : values.shape[1]] = moved * np.sqrt(shrunk)[:, :, None]
    biases = -(moved @ (shrunk * score)[..., None])[..., 0]
    return evidence.ravel(), biases.reshape(-1, moved.shape[1]), spreads.reshape(-1, *spreads.shape[2:])
