"""Differences between all pairs of calibrations of one scanner, compared with their error bars.

Calibrations that differ only by their errors agree in all pairs in 95 % of cases. The 5 % are divided by the number of
comparisons (Bonferroni). The Bonferroni limit holds for any dependence between pairs, and here each calibration is in
several pairs; for 24 calibrations the limit of the scale is 3.7 standard deviations, and 3.6 would be exact.
"""

import math
from itertools import combinations

import numpy as np
import scipy

from sawmill_calibration.failures import refused
from sawmill_contracts.calibrations import CalibrationResult
from sawmill_contracts.plans import PairDifference, RepeatabilityResult
from sawmill_tomography.geometry.fit_parameters import FitParameter
from sawmill_tomography.geometry.ray_error import exceeded_ray_error, predicted_ray_error, ray_error, scale_deviation

# Share of comparisons in which errors alone take some pair beyond its limits.
FALSE_ALARMS = 0.05
# Number of quantities that are compared in a pair: the rays and the scale.
QUESTIONS = 2


def repeatability(named: list[tuple[str, CalibrationResult]]) -> RepeatabilityResult:
    """Compare all pairs of calibrations; refuse fewer than two calibrations, or calibrations of several scanners."""
    if len(named) < 2:
        raise refused("too-few-calibrations", f"{len(named)} calibration was given: give two or more of one scanner")
    share = FALSE_ALARMS / (QUESTIONS * math.comb(len(named), 2))
    pairs = [_difference(*first, *second, share) for first, second in combinations(named, 2)]
    differing = [pair for pair in pairs if not pair.within_error_bars]
    worst = max(pair.ray_difference_mm for pair in pairs)
    if differing:
        who = "the two calibrations differ" if len(pairs) == 1 else f"{len(differing)} of {len(pairs)} pairs differ"
        reason = (
            f"{who} by more than their error bars: fasten the phantom, let the scanner warm up, and look at the "
            "reasons of each calibration"
        )
    else:
        who = "the two calibrations" if len(pairs) == 1 else f"all {len(pairs)} pairs"
        reason = f"{who} agree within their error bars; the rays differ by {worst:.3f} mm at most"
    verdict = "beyond-error-bars" if differing else "repeatable"
    return RepeatabilityResult(pairs=pairs, worst_ray_difference_mm=worst, verdict=verdict, reason=reason)


def _difference(
    first: str, first_result: CalibrationResult, second: str, second_result: CalibrationResult, share: float
) -> PairDifference:
    """Compare two calibrations, whose errors alone take rays, and scale, beyond their limits in this share of cases."""
    if first_result.scanner.with_equal_cells != second_result.scanner.with_equal_cells:
        raise refused(
            "other-scanner", f"{first} and {second} have not the same scanner's constants: compare those of one scanner"
        )
    if first_result.covariance is None or second_result.covariance is None:
        raise refused("without-error-bars", f"{first} or {second} has no error bars: calibrate with --method default")
    radius_mm, covariance = (
        first_result.radius_mm,
        np.array(first_result.covariance) + np.array(second_result.covariance),
    )
    rays = ray_error(
        first_result.scanner,
        first_result.source_frame,
        second_result.source_frame,
        radius_mm=radius_mm,
        other_scanner=second_result.scanner,
    )
    expected = predicted_ray_error(first_result.scanner, first_result.source_frame, covariance, radius_mm=radius_mm)
    scale = scale_deviation(first_result.scanner, first_result.source_frame, covariance, radius_mm=radius_mm)
    allowed = exceeded_ray_error(
        first_result.scanner, first_result.source_frame, covariance, share, radius_mm=radius_mm
    )
    allowed_scale = -float(scipy.special.ndtri(0.5 * share)) * scale
    return PairDifference(
        first=first,
        second=second,
        ray_difference_mm=rays.rms_mm,
        expected_95_mm=expected.upper_95_mm,
        allowed_mm=allowed,
        scale_difference_percent=100.0 * rays.scale_change,
        scale_difference_deviation_percent=100.0 * scale,
        scale_allowed_percent=100.0 * allowed_scale,
        cor_column_difference_mm=second_result.source_frame.cor_column_mm - first_result.source_frame.cor_column_mm,
        cor_column_deviation_mm=math.sqrt(covariance[FitParameter.U_C, FitParameter.U_C]),
        tilt_difference_deg=math.degrees(second_result.source_frame.tilt_rad - first_result.source_frame.tilt_rad),
        tilt_deviation_deg=math.degrees(math.sqrt(covariance[FitParameter.TILT, FitParameter.TILT])),
        within_error_bars=rays.rms_mm <= allowed and abs(rays.scale_change) <= allowed_scale,
    )
