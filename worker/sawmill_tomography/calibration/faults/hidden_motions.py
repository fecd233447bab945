"""Motions that are too small for a scan to show, and that still move the geometry of the fit.

A motion that chance explains is not fitted. If it is real, the fitted columns take up a part of it. The ray error's
bound counts each motion with its likelihood (docs/understand/verdict.md#predicted-ray-error).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sawmill_tomography.calibration.joint_fit.fitted import Fitted
from sawmill_tomography.calibration.joint_fit.normal_equations import System
from sawmill_tomography.calibration.joint_fit.scan_model import Term
from sawmill_tomography.calibration.joint_fit.selection import EffectTester
from sawmill_tomography.geometry.geometry import FloatArray

# The number of motions that a scan hides beforehand (benchmarks/families.py).
EXPECTED = 2.0
# Sizes of hidden motions at the phantom's rim (standard deviations of each unknown, mm): every order of magnitude is
# as likely.
SIZES_MM = np.geomspace(0.03, 0.5, 4)
# Motions with a smaller probability are left out.
LEAST_PROBABILITY = 1e-4


@dataclass(frozen=True, eq=False)
class HiddenMotion:
    """A motion that a scan may hide, of one order of magnitude.

    Attributes
    ----------
    probability : float
        Probability that the motion is real; at most one is.
    bias : (used,) float64; spread : (used, unknowns) float64
        Errors of the fitted columns in this case: their mean, and a root of their covariance beyond noise.
    """

    probability: float
    bias: FloatArray
    spread: FloatArray


def hidden_motions(
    system: System, used: Sequence[int], variance: float, kinds: Sequence[Sequence[Fitted]], radius_mm: float
) -> Iterator[HiddenMotion]:
    """Yield the motions that the residual of this variance may hide.

    Each kind is as likely beforehand; a kind has a motion for each place where it may begin, as likely. The sizes of a
    motion's columns are independent normal variables, and the marginal likelihood of a motion follows from its score.

    Parameters
    ----------
    radius_mm : float
        The phantom's radius: a turn moves the rim by it.
    """
    tester, cases = EffectTester(system, used), list[tuple[float, FloatArray, FloatArray]]()
    for kind in kinds:
        prior = math.log(EXPECTED / (len(kinds) * len(kind) * SIZES_MM.size))
        for one in kind:
            unit = np.array([1.0 / radius_mm if column.parts[0][0] is Term.PSI else 1.0 for column in one.columns])
            left = tester.left(one.places)
            # Independent unknowns of unit deviation: their information, score, and effect on the fitted columns.
            values, vectors = np.linalg.eigh(left.normal * np.outer(unit, unit) / variance)
            score, moved = vectors.T @ (left.score * unit) / variance, left.sensitivity @ (unit[:, None] * vectors)
            for square in SIZES_MM**2:
                shrunk = square / (1.0 + square * np.maximum(values, 0.0))
                evidence = 0.5 * float(np.sum(np.log(shrunk / square) + shrunk * score**2))
                cases.append((prior + evidence, -moved @ (shrunk * score), moved * np.sqrt(shrunk)))
    largest = max((evidence for evidence, *_ in cases), default=0.0)
    weights = [math.exp(evidence - max(largest, 0.0)) for evidence, *_ in cases]
    total = sum(weights) + math.exp(-max(largest, 0.0))
    for weight, (_, bias, spread) in zip(weights, cases, strict=True):
        if weight > LEAST_PROBABILITY * total:
            yield HiddenMotion(weight / total, bias, spread)
