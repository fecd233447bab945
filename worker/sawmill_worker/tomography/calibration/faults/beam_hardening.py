"""Beam hardening: the measured line integral is p + c p^2."""

from dataclasses import replace

from sawmill_worker.tomography import analytic
from sawmill_worker.tomography.calibration.faults.finding import AdjustedFit, TermFinding
from sawmill_worker.tomography.calibration.faults.linear_terms import (
    LEAST_CHI_SQUARE,
    LEAST_SHARE,
    evidence_of,
    refitted_with_term,
)
from sawmill_worker.tomography.fit_parameters import GramTerm
from sawmill_worker.vocabulary import Adjustment

# Hardening below this, on the longest path, is within what a drawing of the phantom may be wrong by
# (benchmarks/misspecified.py).
LEAST_HARDENING = 0.005


def _share(now: AdjustedFit) -> float:
    if now.data.hardening:
        return 0.0
    chi_square, share = evidence_of(now, [GramTerm.SHADOW_SQUARED])
    return share if chi_square >= LEAST_CHI_SQUARE and share >= LEAST_SHARE else 0.0


def _adjust(now: AdjustedFit) -> AdjustedFit:
    after = refitted_with_term(now, replace(now.data, hardening=True))
    if after is None:
        return now
    longest = float(analytic.project(now.phantom, now.data.cells, after.fit.frame, now.data.angles_rad).max())
    if abs(after.fit.hardening * longest) < LEAST_HARDENING:
        return now
    sentence = f"beam hardening of {after.fit.hardening * longest:+.1%} on the longest path was fitted"
    return now.after(after.data, after.fit, sentence)


BEAM_HARDENING = TermFinding(Adjustment.BEAM_HARDENING, _adjust, _share)
