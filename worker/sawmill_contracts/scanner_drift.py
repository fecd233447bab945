"""Drift of a scanner from its drift checks together: pooled values, and a chart that tells a jump from a slow trend."""

from collections.abc import Callable
from datetime import datetime
from typing import Any, NamedTuple, Self

from pydantic import Field, model_validator

from sawmill_contracts.choices import DriftFindingKind, DriftMethod
from sawmill_contracts.drifts import KnownBaseline
from sawmill_platform.contracts.base import Contract, Identifier, Time
from sawmill_vocabulary import DetectorEstimate

# Number of drift checks that the pooled line takes together: 36 minutes of a day of 2 000 logs.
POOLED_LOOKS = 50


class DriftFinding(Contract):
    """Finding of a scanner's drift chart."""

    kind: DriftFindingKind = Field(description="Kind of the finding.", examples=["jump"])
    evidence: float = Field(description="Largest chi-squared of a change, no unit.", examples=[61.0])
    limit: float = Field(
        description="Limit of the evidence; above it the finding is a jump or a trend. No unit.", examples=[40.0]
    )
    scatter: float = Field(
        description="Scatter of the drift checks relative to their error bars, at least 1, no unit.", examples=[1.0]
    )
    began_at: Time | None = Field(
        None,
        description="Time of the jump, or when the trend started. Null: the finding is learning or quiet.",
        examples=["2026-03-09T14:10:00Z"],
    )
    began_between: tuple[Time, Time] | None = Field(
        None,
        description="95 % interval of `began_at`. Null: the finding is learning or quiet.",
        examples=[["2026-03-09T13:40:00Z", "2026-03-09T14:30:00Z"]],
    )
    cor_column_change_mm: float | None = Field(
        None,
        description="Change of u_c: of a jump in mm; of a trend in mm a day. Null: the finding is learning or quiet.",
        examples=[0.12],
    )
    cor_column_standard_deviation_mm: float | None = Field(
        None,
        description="Standard deviation of the change of u_c, in the same unit. Null: the finding is learning or "
        "quiet.",
        examples=[0.01],
    )
    tilt_change_deg: float | None = Field(
        None,
        description="Change of tau: of a jump in degrees; of a trend in degrees a day. Null: the finding is "
        "learning or quiet.",
        examples=[0.01],
    )
    tilt_standard_deviation_deg: float | None = Field(
        None,
        description="Standard deviation of the change of tau, in the same unit. Null: the finding is learning or "
        "quiet.",
        examples=[0.005],
    )

    @model_validator(mode="after")
    def _change_is_whole(self) -> Self:
        of_change = [name for name, field in type(self).model_fields.items() if not field.is_required()]
        missing = [name for name in of_change if getattr(self, name) is None]
        if missing and len(missing) < len(of_change):
            raise ValueError(f"a change must have {', '.join(of_change)}, and {', '.join(missing)} is null")
        return self

    @property
    def sentence(self) -> str:
        """English sentence on what moved and what to do."""
        if self.began_at is None or self.cor_column_change_mm is None or self.tilt_change_deg is None:
            return "the logs show no change of the geometry"
        began = f"about {self.began_at:%Y-%m-%d %H:%M} UTC"
        moved = f"has been moving since {began}" if self.kind == "trend" else f"moved at {began}"
        change = f"{self.cor_column_change_mm:+.3f} mm on the detector, tilt {self.tilt_change_deg:+.3f} degrees"
        rate = " a day" if self.kind == "trend" else ""
        return (
            f"the logs together show that the scanner {moved}: centre of rotation {change}{rate}; "
            "scan the phantom and calibrate"
        )


class PooledDrift(Contract):
    """Drift checks of a scanner by one method since its active calibration, taken together."""

    method: DriftMethod = Field(description="Method by which the drift checks compared views.", examples=["view-pairs"])
    calibration_id: Identifier = Field(description="Id of the active calibration.")
    since: Time = Field(
        description="Time at which this calibration became the active one.", examples=["2026-03-02T05:31:04Z"]
    )
    checks: int = Field(description="Number of drift checks in the chart, no unit.", examples=[2412])
    last_at: Time = Field(description="Time at which the newest drift check ended.", examples=["2026-03-09T14:51:04Z"])
    baseline: KnownBaseline | None = Field(
        description="Mean of the first drift checks, the zero of the chart. Null: not complete."
    )
    baseline_cor_column_mm: float | None = Field(
        description="u_c of the zero, mm. Null: the baseline is not complete.", examples=[-209.02]
    )
    baseline_tilt_deg: float | None = Field(
        description="tau of the zero, degrees. Null: the baseline is not complete.", examples=[-4.761]
    )
    pooled_checks: int = Field(description="Number of the newest drift checks that are pooled, no unit.", examples=[50])
    pooled_cor_column_mm: float = Field(description="u_c from the pooled drift checks, mm.", examples=[-209.02])
    pooled_cor_column_standard_deviation_mm: float = Field(
        description="Standard deviation of the pooled u_c, mm.", examples=[0.006]
    )
    pooled_tilt_deg: float = Field(description="tau from the pooled drift checks, degrees.", examples=[-4.761])
    pooled_tilt_standard_deviation_deg: float = Field(
        description="Standard deviation of the pooled tau, degrees.", examples=[0.004]
    )
    finding: DriftFinding = Field(description="Present finding of the chart.")
    alarm: DriftFinding | None = Field(
        description="First finding of a jump or a trend; its alarm stays open until another calibration is active. "
        "Null: there was none."
    )


class ScannerDrift(Contract):
    """The charts of a scanner since its active calibration."""

    charts: list[PooledDrift] = Field(description="Charts by method; none before the first drift check that counts.")


class CountedLook(NamedTuple):
    """Measurement of a drift check, for the scanner's chart."""

    at: datetime
    days: float  # days since the calibration became the active one
    calibrated: tuple[float, float]  # calibrated (u_c, tau)
    change: DetectorEstimate  # measured values less calibrated ones, with the check's own errors


class Followed(NamedTuple):
    """State of a chart after further drift checks."""

    state: dict[str, Any]  # state of the chart, as JSON
    baseline: KnownBaseline | None
    finding: DriftFinding
    # First finding that is a jump or a trend, and the time at which its drift check ended.
    alarm: tuple[DriftFinding, datetime] | None
    # Mean at each of the new drift checks, in their order, and of how many: this one and those before it.
    pools: list[tuple[DetectorEstimate, int]]


# Function that continues a chart, from its state (empty: a new chart), the method, the newest drift checks that it has
# (`POOLED_LOOKS`), and the next ones, oldest first. None: the function cannot read the state.
Follow = Callable[[dict[str, Any], DriftMethod, list[CountedLook], list[CountedLook]], Followed | None]
