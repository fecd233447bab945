"""A density that slopes over the wood, as with moisture."""

import math
from dataclasses import replace

from sawmill_worker.tomography.calibration.faults.finding import AdjustedFit, TermFinding
from sawmill_worker.tomography.calibration.faults.linear_terms import (
    LEAST_CHI_SQUARE,
    LEAST_SHARE,
    evidence_of,
    refitted_with_term,
)
from sawmill_worker.tomography.fit_parameters import MOMENTS
from sawmill_worker.vocabulary import Adjustment


def _share(now: AdjustedFit) -> float:
    if now.data.density_gradient:
        return 0.0
    chi_square, share = evidence_of(now, MOMENTS)
    return share if chi_square >= 2.0 * LEAST_CHI_SQUARE and share >= LEAST_SHARE else 0.0


def _adjust(now: AdjustedFit) -> AdjustedFit:
    after = refitted_with_term(now, replace(now.data, density_gradient=True))
    if after is None:
        return now
    slope = math.hypot(*after.fit.gradient_per_mm) * 100.0
    return now.after(after.data, after.fit, f"the wood's density slopes by {slope:.1%} in 100 mm, which was fitted")


DENSITY_GRADIENT = TermFinding(Adjustment.DENSITY_GRADIENT, _adjust, _share)
