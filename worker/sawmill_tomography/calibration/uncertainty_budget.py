"""The uncertainty budget of a calibration: what each source does to the rays and to the image's millimetres."""

import numpy as np

from sawmill_tomography.calibration.calibration import CalibrationOutcome
from sawmill_tomography.calibration.judgement import Evidence
from sawmill_tomography.geometry.fit_parameters import FRAME
from sawmill_tomography.geometry.ray_error import predicted_ray_error, scale_deviation
from sawmill_vocabulary.uncertainty import SOURCES, BudgetLine

# RMS ray error, mm, standard uncertainty of the image's millimetres, per cent, and the source's own, or 0 without one.
Contribution = tuple[float, float, float]


def uncertainty_budget(calibration: CalibrationOutcome) -> list[BudgetLine]:
    """Divide the uncertainties of the rays and of the image's millimetres by their sources.

    The squares of the lines in the sum add up to those of `RayErrorPrediction.rms_mm`, and of `size` and `statistical`
    of `ScaleUncertainty`. An answer without error bars has no lines.
    """
    if not isinstance(calibration.findings, Evidence):
        return []
    found = {source: each for source, each in _found(calibration, calibration.findings).items() if any(each[:2])}
    rays, scale, held_mm = found.get("held-source-distance", (0.0, 0.0, 0.0))
    found |= {name: (0.0, one.assumed * one.scale_by_unit, one.assumed) for name, one in SOURCES.items() if one.assumed}
    if held_mm:  # otherwise h_S takes another r_S up, as SDD and u_c always do with another distance of the cells
        found["source-distance"] = (rays / held_mm, scale / held_mm, 1.0)
    summed = np.square([each[:2] for source, each in found.items() if SOURCES[source].counted_in == "sum"]).sum(axis=0)
    return [_line(source, found[source], summed.tolist()) for source in SOURCES if source in found]


def _line(source: str, contribution: Contribution, summed: list[float]) -> BudgetLine:
    """Make a line with its shares of the summed variances of the rays and of the millimetres."""
    (rays_mm, scale_percent, size), about = contribution, SOURCES[source]
    both = zip((rays_mm, scale_percent), summed, strict=True)
    rays, scale = (100.0 * own * own / whole if whole and about.counted_in == "sum" else None for own, whole in both)
    of_rays, of_scale = (rays_mm, rays_mm / size if size else None, rays), (scale_percent, scale)
    return BudgetLine(source, size or None, *of_rays, *of_scale, about.kind, about.counted_in, about.unit, about.states)


def _found(calibration: CalibrationOutcome, evidence: Evidence) -> dict[str, Contribution]:
    """Return the contributions that the answer's numbers have, by source."""
    scanner, frame, radius_mm = calibration.scanner, calibration.frame, calibration.radius_mm
    statistics, predicted = evidence.error_bars.statistics, evidence.error_bars.predicted_ray_error
    poses, witness, scale = evidence.residual.poses, evidence.witness, evidence.scale
    covariances = dict(statistics.parts)
    if (mixture := statistics.mixture) is not None:
        covariances["other-motions"] = mixture.errors.T @ mixture.errors / mixture.draws
    both = {"cell-places": (statistics.further_mm, 0.0)}
    for source, part in covariances.items():
        of_scale = scale_deviation(scanner, frame, part[FRAME, FRAME], radius_mm=radius_mm)
        both[source] = predicted_ray_error(scanner, frame, part, radius_mm=radius_mm).rms_mm, 100.0 * of_scale
    if poses is not None and witness is None:
        # The poses of views take up errors of the geometry: only both together do something to the rays.
        both = {"view-poses": (predicted.rms_mm, 100.0 * scale.statistical)}
    noise_mm, _ = both.get("noise", (0.0, 0.0))
    alike = {source: rays / noise_mm for source, (rays, _) in both.items() if noise_mm and SOURCES[source].unit == "1"}
    sizes = {source: statistics.noise * times for source, times in alike.items()} | {
        "view-poses": 0.0 if poses is None else poses.shift_mm,
        "cell-places": statistics.further_mm,
        "log": 0.0 if witness is None else witness.log.detector.deviations[0],
        "held-source-distance": max(scanner.source_to_cor_mm - evidence.source_distance.unconstrained_mm, 0.0),
    }
    return {source: (*each, sizes.get(source, 0.0)) for source, each in both.items()} | {
        "phantom-size": (0.0, 100.0 * scale.size, 100.0 * scale.size),
        "aspect": (0.0, 100.0 * scale.aspect_half, 100.0 * scale.aspect_half),
        "found-modules" if scanner.detector_modules else "hidden-modules": (predicted.hidden_mm, 0.0, 0.0),
    }
