"""Views that differ in gain or background, as when the tube's output drifts."""

from dataclasses import replace

from sawmill_worker.tomography.calibration.faults.finding import AdjustedFit, TermFinding
from sawmill_worker.tomography.calibration.faults.linear_terms import LEAST_SHARE, evidence_of, refitted_with_term
from sawmill_worker.vocabulary import Adjustment

SENTENCE = "the views differ in gain or background: each was fitted with its own"


def _share(now: AdjustedFit) -> float:
    if now.data.view_gain:
        return 0.0
    views = len(now.data.sinogram)
    chi_square, share = evidence_of(now, [], view_gain=True)
    # Two terms a view always remove two samples' worth a view.
    chance = 4.0 * views / now.data.sinogram.size
    return share if chi_square >= 2.0 * (2.0 * views) and share >= LEAST_SHARE + chance else 0.0


def _adjust(now: AdjustedFit) -> AdjustedFit:
    return refitted_with_term(now, replace(now.data, view_gain=True), SENTENCE) or now


VIEW_GAIN = TermFinding(Adjustment.VIEW_GAIN, _adjust, _share)
