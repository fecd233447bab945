"""Differences between calibrations of one scanner, against their error bars."""

from typing import Literal

from pydantic import Field

from sawmill_platform.contracts.base import Contract


class PairDifference(Contract):
    """The second calibration less the first."""

    first: str
    second: str
    ray_difference_mm: float = Field(description="RMS inside the log's disc, over one common rotation and scale.")
    expected_95_mm: float = Field(
        description="What both error bars leave it below in 95 of 100 cases, in this pair alone."
    )
    allowed_mm: float = Field(
        description="What error bars leave it below, as of all pairs and their scales, in 95 of 100 comparisons."
    )
    scale_difference_percent: float
    scale_difference_deviation_percent: float = Field(description="Noise alone: the phantom's size is common to both.")
    scale_allowed_percent: float = Field(
        description="Largest difference of scale of a pair that agrees, as `allowed_mm`."
    )
    cor_column_difference_mm: float
    cor_column_deviation_mm: float
    tilt_difference_deg: float
    tilt_deviation_deg: float
    within_error_bars: bool = Field(
        description="The rays within `allowed_mm`, the scale within `scale_allowed_percent`."
    )


class RepeatabilityResult(Contract):
    """Differences of all pairs of some calibrations of one scanner."""

    pairs: list[PairDifference]
    worst_ray_difference_mm: float
    verdict: Literal["repeatable", "beyond-error-bars"]
    reason: str
