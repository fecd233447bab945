"""The uncertainty budget of a calibration: what each source does to the rays and to the image's millimetres."""

import numpy as np

from sawmill_tomography.calibration.calibration import CalibrationOutcome
from sawmill_tomography.calibration.judgement import Evidence
from sawmill_tomography.geometry.fit_parameters import FRAME
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.geometry.ray_error import predicted_ray_error, scale_deviation
from sawmill_vocabulary.uncertainty import ASSUMED, BY_MOISTURE, BY_TEMPERATURE, BudgetLine, UncertaintySource

# By source: RMS ray error, mm, and standard uncertainty of the image's millimetres, per cent.
Contributions = dict[UncertaintySource, tuple[float, float]]


def uncertainty_budget(calibration: CalibrationOutcome) -> list[BudgetLine]:
    """Divide the uncertainties of the rays and of the image's millimetres by their sources.

    The squares of the lines in the sum add up to those of `RayErrorPrediction.rms_mm`, and of `size` and `statistical`
    of `ScaleUncertainty`. An answer without error bars has no lines.
    """
    evidence = calibration.findings
    if not isinstance(evidence, Evidence):
        return []
    found = {source: both for source, both in _contributions(calibration, evidence).items() if any(both)}
    sizes = _sizes(calibration, evidence, found) | ASSUMED
    # Cells at other distances change SDD and u_c alone, another r_S h_S alone: the rays stay, unless R was held there.
    rays, scale = found.get(UncertaintySource.HELD, (0.0, 0.0))
    by_r_s = (rays / sizes.get(UncertaintySource.HELD, 1.0), scale / sizes.get(UncertaintySource.HELD, 1.0))
    moves = {UncertaintySource.PITCH: (0.0, 0.0), UncertaintySource.SOURCE_DISTANCE: by_r_s}
    moves |= {UncertaintySource.MOISTURE: (0.0, BY_MOISTURE), UncertaintySource.TEMPERATURE: (0.0, BY_TEMPERATURE)}
    found |= {source: (sizes[source] * rays, sizes[source] * scale) for source, (rays, scale) in moves.items()}
    summed = np.square([both for source, both in found.items() if source.counted_in == "sum"]).sum(axis=0)
    return [_line(source, found[source], sizes.get(source), summed) for source in UncertaintySource if source in found]


def _contributions(calibration: CalibrationOutcome, evidence: Evidence) -> Contributions:
    """Return what the sources do whose sizes the answer has."""
    scanner, frame, radius_mm = calibration.scanner, calibration.frame, calibration.radius_mm
    statistics, predicted = evidence.error_bars.statistics, evidence.error_bars.predicted_ray_error

    def of_covariance(part: FloatArray) -> tuple[float, float]:
        scale = scale_deviation(scanner, frame, part[FRAME, FRAME], radius_mm=radius_mm)
        return predicted_ray_error(scanner, frame, part, radius_mm=radius_mm).rms_mm, 100.0 * scale

    if calibration.view_poses is None or evidence.witness is not None:
        found = {source: of_covariance(part) for source, part in statistics.parts.items()}
        found[UncertaintySource.CELL_PLACES] = (statistics.further_mm, 0.0)
    else:  # the poses of views take up errors of the geometry: only both together do something to the rays
        found = {UncertaintySource.VIEW_POSES: (predicted.rms_mm, 100.0 * evidence.scale.statistical)}
    instead = 0.0
    if statistics.mixture is not None:
        errors = statistics.mixture.errors[:, FRAME]
        instead = scale_deviation(scanner, frame, errors.T @ errors / statistics.mixture.draws, radius_mm=radius_mm)
    return found | {
        UncertaintySource.SIZE: (0.0, 100.0 * evidence.scale.size),
        UncertaintySource.EXPLANATIONS: (predicted.instead_mm, 100.0 * instead),
        UncertaintySource.MODULES: (predicted.hidden_mm, 0.0),
        UncertaintySource.ASPECT: (0.0, 100.0 * evidence.scale.aspect_half),
    }


def _sizes(calibration: CalibrationOutcome, evidence: Evidence, found: Contributions) -> dict[UncertaintySource, float]:
    """Return the standard uncertainties of the sources that have one size, in their units."""
    poses, witness, noise = evidence.residual.poses, evidence.witness, evidence.error_bars.statistics.noise
    by_noise = found.get(UncertaintySource.NOISE, (0.0, 0.0))[0]
    sizes = {source: noise * rays / by_noise for source, (rays, _) in found.items() if source.unit == "1" and by_noise}
    sizes |= {
        UncertaintySource.VIEW_POSES: 0.0 if poses is None else poses.shift_mm,
        UncertaintySource.CELL_PLACES: evidence.error_bars.statistics.further_mm,
        UncertaintySource.LOG: 0.0 if witness is None else witness.log.detector.deviations[0],
        UncertaintySource.HELD: calibration.scanner.source_to_cor_mm - evidence.source_distance.unconstrained_mm,
        UncertaintySource.SIZE: 100.0 * evidence.scale.size,
        UncertaintySource.ASPECT: 100.0 * evidence.scale.aspect_half,
    }
    return {source: size for source, size in sizes.items() if size > 0.0}


def _line(source: UncertaintySource, both: tuple[float, float], size: float | None, summed: FloatArray) -> BudgetLine:
    """Make a line with its shares of the summed variances (2,), of the rays and of the millimetres."""
    shares = [100.0 * one * one / whole if whole else 0.0 for one, whole in zip(both, summed.tolist(), strict=True)]
    rays, scale = shares if source.counted_in == "sum" else (None, None)
    by_unit = both[0] / size if size else None
    return BudgetLine(source, size, both[0], by_unit, rays, both[1], scale, source.kind, source.counted_in, source.unit)
