"""The hypotheses and first angles that compete with the best fit, and how much less likely they are."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sawmill_tomography.calibration.fit import Fit, OnStep, ignore_progress, refine
from sawmill_tomography.calibration.search.misfit import COARSE_VIEWS, TURNS
from sawmill_tomography.calibration.task import CalibrationTask, PoseHypothesis
from sawmill_tomography.geometry.geometry import TAU, angle_difference
from sawmill_vocabulary import Handedness, Rotation

# Hypotheses whose coarse residual is within this factor of the least are fitted to all the data and compared.
CONTENDER = 3.0
ITERATIONS = 60
# Log-likelihood advantage over the next hypothesis below which the choice is not decisive.
DECISIVE = 10.0


class RankedFit(NamedTuple):
    """A fit to all the data, and its hypothesis."""

    hypothesis: PoseHypothesis
    fit: Fit


@dataclass(frozen=True)
class HypothesisReport:
    """A hypothesis of the four, and the share of the sinogram that the hypothesis leaves unexplained."""

    handedness: Handedness
    rotation: Rotation
    relative_residual: float


@dataclass(frozen=True)
class TurnedAlternative:
    """The best fit of the same hypothesis with the phantom turned."""

    by_deg: float
    relative_residual: float


@dataclass(frozen=True)
class Alternatives:
    """The hypotheses and turned phantoms that were also fitted to the scan."""

    hypotheses: tuple[HypothesisReport, ...]  # every hypothesis once, best first
    turned: TurnedAlternative | None = None  # None where no other first angle was found
    # Number of samples of the sinogram that do not only repeat neighbouring samples; None from a method without error
    # bars
    independent_samples: float | None = None

    def log_likelihood_behind(self, relative_residual: float) -> float | None:
        """Return by how much a fit with this residual is behind the best in log-likelihood; None where unknown."""
        if self.independent_samples is None:
            return None
        best = self.hypotheses[0].relative_residual
        rounding = math.sqrt(np.finfo(np.float64).eps)  # of the root of a sum of squares
        return self.independent_samples * math.log(max(relative_residual, rounding) / max(best, rounding))

    def undecided(self, relative_residual: float) -> bool:
        """Return whether the best fit's log-likelihood hardly exceeds a fit's with this relative residual."""
        behind = self.log_likelihood_behind(relative_residual)
        return behind is not None and behind < DECISIVE


def fit_hypotheses(
    task: CalibrationTask, coarse: Mapping[PoseHypothesis, Sequence[Fit]], on_step: OnStep = ignore_progress
) -> list[RankedFit]:
    """Fit the hypotheses to all the data, best first, one fit for each first angle.

    A hypothesis that cannot be the best is only measured, on some of the views.
    """
    least = min((fit.relative_residual for fits in coarse.values() for fit in fits), default=0.0)
    fitted: list[RankedFit] = []
    for hypothesis, starts in coarse.items():
        data = task.full_data(hypothesis.rotation)
        for number, start in enumerate(starts):
            contends = start.relative_residual <= CONTENDER * least
            if number > 0 and not contends:
                continue
            # The coarse residual has its noise averaged away: a fit that cannot win is still measured on all the cells.
            fit = refine(
                task.phantoms[hypothesis.handedness],
                data if contends else data.every(max(1, len(data.sinogram) // COARSE_VIEWS)),
                start.frame,
                position_mm=start.position_mm,
                max_iterations=ITERATIONS if contends else 0,
                on_step=on_step,
            )
            if fit is not None:
                fitted.append(RankedFit(hypothesis, fit))
    return _one_of_each_angle(fitted)


def by_hypothesis(ranked: Sequence[RankedFit]) -> dict[PoseHypothesis, list[Fit]]:
    """Group the fits by hypothesis, in the same order."""
    fits: dict[PoseHypothesis, list[Fit]] = {}
    for hypothesis, fit in ranked:
        fits.setdefault(hypothesis, []).append(fit)
    return fits


def alternatives_of(ranked: Sequence[RankedFit], independent_samples: float) -> Alternatives:
    """Return the alternatives to the first of these fits."""
    reports: dict[PoseHypothesis, HypothesisReport] = {}
    for hypothesis, fit in ranked:
        reports.setdefault(hypothesis, HypothesisReport(*hypothesis, fit.relative_residual))
    best = ranked[0]
    turned = [fit for hypothesis, fit in ranked[1:] if hypothesis == best.hypothesis]
    rival = (
        TurnedAlternative(math.degrees(_apart(best.fit, turned[0])), turned[0].relative_residual) if turned else None
    )
    return Alternatives(tuple(reports.values()), rival, independent_samples)


def _one_of_each_angle(fitted: list[RankedFit]) -> list[RankedFit]:
    ranked: list[RankedFit] = []
    for hypothesis, fit in sorted(fitted, key=lambda one: one.fit.relative_residual):
        if all(hypothesis != better.hypothesis or _apart(fit, better.fit) > TAU / TURNS for better in ranked):
            ranked.append(RankedFit(hypothesis, fit))
    return ranked


def _apart(a: Fit, b: Fit) -> float:
    return abs(angle_difference(a.frame.psi_rad, b.frame.psi_rad))
