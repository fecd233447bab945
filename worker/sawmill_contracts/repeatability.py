"""Differences between calibrations of one scanner, against their error bars."""

from typing import Literal

from pydantic import Field

from sawmill_platform.contracts.base import Contract


class PairDifference(Contract):
    """Difference of a pair: the second calibration less the first."""

    first: str
    second: str
    ray_difference_mm: float = Field(
        description="RMS distance between the rays inside the log's disc, up to one common rotation and scale."
    )
    expected_95_mm: float = Field(
        description="Upper 95 % limit of the ray difference by both error bars, for this pair alone."
    )
    allowed_mm: float = Field(
        description="Limit of the ray difference by the error bars of all pairs and their scales, 95 %."
    )
    scale_difference_percent: float
    scale_difference_deviation_percent: float = Field(
        description="Standard deviation from noise alone: the phantom's size is common to both."
    )
    scale_allowed_percent: float = Field(
        description="Limit of the difference of scale, as `allowed_mm` is of the ray difference."
    )
    cor_column_difference_mm: float
    cor_column_deviation_mm: float
    tilt_difference_deg: float
    tilt_deviation_deg: float
    within_error_bars: bool = Field(
        description="Whether the rays are within `allowed_mm` and the scale within `scale_allowed_percent`."
    )


class RepeatabilityResult(Contract):
    """Differences of all pairs of some calibrations of one scanner."""

    pairs: list[PairDifference]
    worst_ray_difference_mm: float
    verdict: Literal["repeatable", "beyond-error-bars"]
    reason: str
