"""What more linear terms would explain of a residual, and which of them are taken into the model."""

import math
from collections.abc import Sequence

import numpy as np

from sawmill_worker.tomography.calibration.elimination import project_out, reduce
from sawmill_worker.tomography.calibration.faults.finding import AdjustedFit, TermFinding
from sawmill_worker.tomography.calibration.fit import refine
from sawmill_worker.tomography.calibration.sinogram_data import SinogramData
from sawmill_worker.tomography.fit_parameters import GramTerm, Parameter

# A term is taken in when its chi-square per parameter exceeds this and it removes this share of the residual's power
# (benchmarks/misspecified.py).
LEAST_CHI_SQUARE, LEAST_SHARE = 50.0, 0.02


def take_terms(now: AdjustedFit, terms: Sequence[TermFinding]) -> AdjustedFit:
    """Take in the terms that are worth it, each time the one that explains most."""
    waiting = list(terms)
    while waiting:
        shares = [term.share(now) for term in waiting]
        best = int(np.argmax(shares))
        if shares[best] == 0.0:
            break
        now = waiting.pop(best).adjust(now)
    return now


def evidence_of(now: AdjustedFit, extras: Sequence[GramTerm], *, view_gain: bool = False) -> tuple[float, float]:
    """Chi-square and share of the residual's power that more linear terms would remove, to first order."""
    kept = [*Parameter, GramTerm.DATA]

    def remaining(terms: Sequence[GramTerm], *, by_view: bool) -> float:
        schur, _ = reduce(now.grams, terms, kept, view_gain=by_view)
        return float(project_out(schur, list(range(len(Parameter))), [len(Parameter)])[0][0, 0])

    try:
        before = remaining(now.data.extras, by_view=now.data.view_gain)
        after = remaining([*now.data.extras, *extras], by_view=now.data.view_gain or view_gain)
    except np.linalg.LinAlgError:  # the scan does not determine the geometry as it is: more terms cannot be judged
        return 0.0, 0.0
    if not (math.isfinite(before) and before > 0.0):
        return 0.0, 0.0
    share = max(before - after, 0.0) / before
    return share * now.data.samples / now.scatter.inflation, share


def refitted_with_term(now: AdjustedFit, data: SinogramData, sentence: str = "") -> AdjustedFit | None:
    """The fit with one more term; None where it explains no more."""
    fit = refine(now.phantom, data, now.fit.frame, position_mm=now.fit.position_mm)
    if fit is None or fit.relative_residual >= now.fit.relative_residual:
        return None
    return now.after(data, fit, sentence)
