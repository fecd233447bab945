"""The uncertainty budget of a calibration: what each source does to the rays and to the image's millimetres."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sawmill_tomography.calibration.calibration import CalibrationOutcome
from sawmill_tomography.calibration.joint_fit.normal_equations import WIDER
from sawmill_tomography.calibration.judgement import Evidence
from sawmill_tomography.geometry.fit_parameters import FRAME
from sawmill_tomography.geometry.ray_error import ray_form, scale_gradient
from sawmill_vocabulary import Adjustment
from sawmill_vocabulary.uncertainty import (
    LINE_INTEGRAL,
    MOISTURE_MOVES,
    STATED,
    TEMPERATURE_MOVES,
    UncertaintySource,
)


@dataclass(frozen=True)
class BudgetLine:
    """A source of uncertainty, and its contributions to the rays and to the image's millimetres."""

    source: UncertaintySource
    standard_uncertainty: float | None  # in the source's unit; of a misfit, of noise with the same effect
    rays_mm: float  # RMS ray error
    scale_percent: float
    rays_share_percent: float | None = None  # shares in the variances; None where the source is not in the sums
    scale_share_percent: float | None = None

    @property
    def rays_mm_per_unit(self) -> float | None:
        """Sensitivity of the rays; None where the source has no standard uncertainty."""
        return None if self.standard_uncertainty is None else self.rays_mm / self.standard_uncertainty

    @property
    def scale_percent_per_unit(self) -> float | None:
        """Sensitivity of the image's millimetres."""
        return None if self.standard_uncertainty is None else self.scale_percent / self.standard_uncertainty


# Standard uncertainties of the rays, mm, and of the image's millimetres, per cent.
Contribution = tuple[float, float]


def uncertainty_budget(calibration: CalibrationOutcome) -> list[BudgetLine]:
    """Divide the variances of the rays and of the image's millimetres into their sources.

    The lines that are counted in the sum add up to the mean square of `RayErrorPrediction.rms_mm`, and to the variance
    of the phantom's size and of R/SDD in `ScaleUncertainty`. An answer without error bars has no lines.
    """
    evidence = calibration.findings
    if not isinstance(evidence, Evidence):
        return []
    summed = _in_sum(calibration, evidence)
    rays, scale = (math.fsum(squares) for squares in zip(*summed.values(), strict=True))
    sizes = _standard_uncertainties(evidence, summed, calibration.scanner.source_to_cor_mm)
    lines = []
    for source, squares in summed.items():
        if any(squares):
            shares = [
                100.0 * own / every if every > 0.0 else 0.0 for own, every in zip(squares, (rays, scale), strict=True)
            ]
            lines.append(BudgetLine(source, sizes.get(source), *_deviations(squares), *shares))
    lines.sort(key=lambda line: -line.rays_mm)
    lines += [each for each in _in_bound(calibration, evidence) if each.rays_mm or each.scale_percent]
    distance = sizes.get(UncertaintySource.HELD_DISTANCE)
    held = _deviations(summed.get(UncertaintySource.HELD_DISTANCE, (0.0, 0.0)))
    # Cells at other distances move SDD and u_c alone, another r_S moves h_S alone: the rays stay, unless R was held.
    moves = {
        UncertaintySource.MOISTURE: (0.0, MOISTURE_MOVES),
        UncertaintySource.TEMPERATURE: (0.0, TEMPERATURE_MOVES),
        UncertaintySource.PITCH: (0.0, 0.0),
        UncertaintySource.SOURCE_DISTANCE: (held[0] / (distance or 1.0), held[1] / (distance or 1.0)),
    }
    return lines + [
        BudgetLine(source, size, *(size * each for each in moves[source])) for source, size in STATED.items()
    ]


def _in_sum(calibration: CalibrationOutcome, evidence: Evidence) -> dict[UncertaintySource, Contribution]:
    """Return the variances, mm^2 and per cent^2, that add up to those of the answer."""
    bars, scanner, frame, radius_mm = evidence.error_bars, calibration.scanner, calibration.frame, calibration.radius_mm
    form = ray_form(scanner, frame, len(bars.ray_covariance), radius_mm=radius_mm)
    gradient = 100.0 * scale_gradient(scanner, frame, radius_mm=radius_mm)
    summed = {
        source: (float((form * part).sum()), float(gradient @ part[FRAME, FRAME] @ gradient))
        for source, part in bars.parts.items()
    }
    if calibration.view_poses is not None and evidence.witness is None:
        # The poses of views take up errors of the geometry: only both together have an effect on the rays.
        scale = math.fsum(each for _, each in summed.values())
        summed = {UncertaintySource.VIEW_POSES: (bars.predicted_ray_error.rms_mm**2, scale)}
    else:
        summed[UncertaintySource.CELL_PLACES] = (bars.further_mm**2, 0.0)
    return summed | {UncertaintySource.SIZE: (0.0, (100.0 * evidence.scale.size) ** 2)}


def _in_bound(calibration: CalibrationOutcome, evidence: Evidence) -> Iterator[BudgetLine]:
    """Yield what counts in the bounds alone: the errors that draws add, and the whole limit by the phantom's aspect."""
    bars, aspect = evidence.error_bars, 100.0 * evidence.scale.aspect_half
    scale = 0.0
    if bars.mixture is not None:
        gradient = 100.0 * scale_gradient(calibration.scanner, calibration.frame, radius_mm=calibration.radius_mm)
        scale = math.sqrt(float(np.square(bars.mixture.errors[:, FRAME] @ gradient).sum()) / bars.mixture.draws)
    yield BudgetLine(UncertaintySource.EXPLANATIONS, None, bars.predicted_ray_error.instead_mm, scale)
    yield BudgetLine(UncertaintySource.MODULES, None, bars.predicted_ray_error.hidden_mm, 0.0)
    yield BudgetLine(UncertaintySource.ASPECT, aspect, 0.0, aspect)


def _standard_uncertainties(
    evidence: Evidence, summed: dict[UncertaintySource, Contribution], source_to_cor_mm: float
) -> dict[UncertaintySource, float]:
    """Return the standard uncertainties of the sources that have one, in their units."""
    bars, residual, witness = evidence.error_bars, evidence.residual, evidence.witness
    found = {effect.adjustment: effect.reason.values for effect in residual.effects}
    sizes = {
        UncertaintySource.SIZE: 100.0 * evidence.scale.size,
        UncertaintySource.CELL_PLACES: bars.further_mm,
        UncertaintySource.HELD_DISTANCE: source_to_cor_mm - evidence.source_distance.unconstrained_mm,
        UncertaintySource.VIEW_POSES: 0.0 if residual.poses is None else residual.poses.shift_mm,
        UncertaintySource.LOG: 0.0 if witness is None else witness.log.detector.deviations[0],
        UncertaintySource.VIEW_ANGLES: float(found.get(Adjustment.ANGLE_JITTER, {}).get("jitter_deg", 0.0)),
        UncertaintySource.WOOD_DENSITY: WIDER
        * float(found.get(Adjustment.WOOD_DENSITY, {}).get("deviation_percent", 0.0)),
    }
    by_noise, _ = summed.get(UncertaintySource.NOISE, (0.0, 0.0))
    if by_noise > 0.0:
        alike = [source for source in summed if source.unit == LINE_INTEGRAL]
        sizes |= {source: bars.noise * math.sqrt(max(summed[source][0], 0.0) / by_noise) for source in alike}
    return {source: size for source, size in sizes.items() if size > 0.0}


def _deviations(squares: Contribution) -> Contribution:
    rays, scale = squares
    return math.sqrt(max(rays, 0.0)), math.sqrt(max(scale, 0.0))
