"""Scheduled recalibration."""

from datetime import datetime

from pydantic import Field

from sawmill_worker.contracts import patterns
from sawmill_worker.contracts.base import Contract, Identifier, Stamped
from sawmill_worker.contracts.calibrations import CalibrationOptions, GivenCalibrationOptions
from sawmill_worker.contracts.choices import OnPass, ScheduleOutcome
from sawmill_worker.contracts.given import Given


class ScheduleSpec(Contract):
    """When to recalibrate a scanner with its newest phantom scan that no calibration has used yet."""

    scanner_id: Identifier = Field(examples=["example"], description="Id of the scanner that is recalibrated.")
    cron: str = Field(
        max_length=100,
        description="Five fields of cron, by the clocks of `time_zone`: minute, hour, day of the month, month, day of "
        "the week. Lists, ranges and steps, names of months and days, L and LW for the month's last day and working "
        "day.",
        examples=["30 5 * * 1-6"],
        json_schema_extra={"pattern": patterns.CRON},
    )
    time_zone: str = Field(
        default="UTC",
        max_length=64,
        description="The time zone of `cron`, by its name in the tz database. On the days when its clocks are put "
        "forward or back, an hour that `cron` names comes once; `*` stands for each hour that passes.",
        examples=["Europe/Helsinki"],
    )
    enabled: bool = Field(default=True, description="False: nothing is due until it is enabled.", examples=[True])
    on_pass: OnPass = Field(
        "report",
        description="What to do with a calibration whose rays_verdict is pass and which has not moved.",
        examples=["report"],
    )
    options: CalibrationOptions = Field(CalibrationOptions(), description="How it calibrates.")


class ScheduleAsk(ScheduleSpec, Given):
    """A schedule that is to be kept."""

    options: GivenCalibrationOptions = Field(GivenCalibrationOptions(), description="How it calibrates.")


class ScheduleRun(Contract):
    """The outcome of one due time."""

    due_at: datetime = Field(description="The due time, RFC 3339, UTC.", examples=["2026-03-02T05:30:00Z"])
    outcome: ScheduleOutcome = Field(description="Whether a calibration was queued.", examples=["queued"])
    calibration_id: Identifier | None = Field(
        None, description="Id of the calibration that was queued. Null: none was.", examples=["example"]
    )


class Schedule(Stamped, ScheduleSpec):
    """A schedule as it stands."""

    next_due_at: datetime | None = Field(description="Null when disabled.", examples=["2026-03-03T05:30:00Z"])
    last_run: ScheduleRun | None = Field(None, description="The outcome of the last due time. Null: none has come.")
