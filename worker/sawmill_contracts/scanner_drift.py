"""What the drift checks of a scanner say together: pooled, and by a chart that tells a jump from a slow trend."""

from collections.abc import Callable
from datetime import datetime
from typing import Any, NamedTuple, Self

from pydantic import Field, model_validator

from sawmill_contracts.choices import DriftFindingKind, DriftMethod
from sawmill_contracts.drift_baselines import KnownBaseline
from sawmill_platform.contracts.base import Contract, Identifier, Time

# Looks that the pooled line takes together: 36 minutes of a day of 2 000 logs.
POOLED_LOOKS = 50


class DriftFinding(Contract):
    """What the chart of a scanner finds."""

    kind: DriftFindingKind = Field(description="What it is.", examples=["jump"])
    evidence: float = Field(description="Chi-squared of the change that has most of it, no unit.", examples=[61.0])
    limit: float = Field(description="Evidence above this is a jump or a trend, no unit.", examples=[40.0])
    scatter: float = Field(
        description="How many times farther checks scatter than their errors say, at least 1, no unit.", examples=[1.0]
    )
    began_at: Time | None = Field(
        None,
        description="When it moved, or began to. Null: it is learning or quiet.",
        examples=["2026-03-09T14:10:00Z"],
    )
    began_between: tuple[Time, Time] | None = Field(
        None,
        description="Where that time lies with 95 %. Null: as before.",
        examples=[["2026-03-09T13:40:00Z", "2026-03-09T14:30:00Z"]],
    )
    cor_column_change_mm: float | None = Field(
        None, description="Of a jump the change of u_c, mm; of a trend the change a day, mm.", examples=[0.12]
    )
    cor_column_standard_deviation_mm: float | None = Field(None, description="Of that, mm.", examples=[0.01])
    tilt_change_deg: float | None = Field(
        None, description="Of a jump the change of tau, degrees; of a trend the change a day, degrees.", examples=[0.01]
    )
    tilt_standard_deviation_deg: float | None = Field(None, description="Of that, degrees.", examples=[0.005])

    @model_validator(mode="after")
    def _change_is_whole(self) -> Self:
        of_change = [name for name, field in type(self).model_fields.items() if not field.is_required()]
        missing = [name for name in of_change if getattr(self, name) is None]
        if missing and len(missing) < len(of_change):
            msg = f"a change must have {', '.join(of_change)}, and {', '.join(missing)} is null"
            raise ValueError(msg)
        return self

    @property
    def sentence(self) -> str:
        """What moved, and what to do, in English."""
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
    """Drift checks of a scanner by one method since its active calibration, together."""

    method: DriftMethod = Field(description="By which they compared views.", examples=["view-pairs"])
    calibration_id: Identifier = Field(description="Id of the active calibration.", examples=["example"])
    since: Time = Field(description="When that became the active one.", examples=["2026-03-02T05:31:04Z"])
    looks: int = Field(description="Number of drift checks in the chart, no unit.", examples=[2412])
    last_at: Time = Field(description="When the newest of them ended.", examples=["2026-03-09T14:51:04Z"])
    baseline: KnownBaseline | None = Field(description="What the first of them measured: zero. Null: not complete.")
    baseline_cor_column_mm: float | None = Field(description="u_c of the zero, mm. Null as before.", examples=[-209.02])
    baseline_tilt_deg: float | None = Field(description="tau of the zero, degrees. Null as before.", examples=[-4.761])
    pooled_looks: int = Field(description="Number of the newest of them that are pooled, no unit.", examples=[50])
    pooled_cor_column_mm: float = Field(description="u_c, as these see it together, mm.", examples=[-209.02])
    pooled_cor_column_standard_deviation_mm: float = Field(description="Of that, mm.", examples=[0.006])
    pooled_tilt_deg: float = Field(description="tau, as these see it together, degrees.", examples=[-4.761])
    pooled_tilt_standard_deviation_deg: float = Field(description="Of that, degrees.", examples=[0.004])
    finding: DriftFinding = Field(description="What the chart finds now.")
    alarm: DriftFinding | None = Field(
        description="What it found first; the alarm stays open until another calibration is active. Null: nothing."
    )


class ScannerDrift(Contract):
    """The charts of a scanner since its active calibration."""

    charts: list[PooledDrift] = Field(description="By method; none before the first drift check that counts.")


class CountedLook(NamedTuple):
    """What a drift check measured, for the chart of its scanner.

    Attributes
    ----------
    days
        Since the calibration became the active one.
    cor_column_mm, tilt_rad
        As measured.
    cor_column_change_mm, tilt_change_rad
        Less calibrated.
    covariance
        Of (u_c, tilt), in mm and radians.
    """

    at: datetime
    days: float
    cor_column_mm: float
    tilt_rad: float
    cor_column_change_mm: float
    tilt_change_rad: float
    covariance: tuple[tuple[float, float], tuple[float, float]]


class Pool(NamedTuple):
    """Some looks as one: their number, u_c and tau with their standard deviations."""

    looks: int
    cor_column_mm: float
    cor_column_standard_deviation_mm: float
    tilt_rad: float
    tilt_standard_deviation_rad: float


class Followed(NamedTuple):
    """What a chart says after some looks more.

    Attributes
    ----------
    state
        What JSON keeps of the chart.
    pools
        For each of the new looks, in their order: it and those before it together.
    alarm
        The first of the findings that was a jump or a trend, and when the look ended that showed it.
    """

    state: dict[str, Any]
    baseline: KnownBaseline | None
    finding: DriftFinding
    alarm: tuple[DriftFinding, datetime] | None
    pools: list[Pool]


# What continues a chart: its state (empty: it begins), by which method, the newest looks that it has (`POOLED_LOOKS`),
# and the next ones, oldest first. None: it cannot read the state.
Follow = Callable[[dict[str, Any], DriftMethod, list[CountedLook], list[CountedLook]], Followed | None]
