"""Scheduled recalibration."""

from datetime import datetime

from pydantic import Field

from sawmill_worker.contracts.base import Contract, Identifier, Stamped
from sawmill_worker.contracts.calibrations import CalibrationOptions, GivenCalibrationOptions
from sawmill_worker.contracts.choices import OnPass, ScheduleOutcome
from sawmill_worker.contracts.given import Given


class ScheduleSpec(Contract):
    """When to recalibrate a scanner with its newest phantom scan that no calibration has used yet."""

    scanner_id: Identifier = Field(examples=["example"])
    cron: str = Field(max_length=100, description="Five fields, in UTC.", examples=["30 5 * * 1-6"])
    enabled: bool = True
    on_pass: OnPass = Field(
        "report", description="What to do with a calibration whose rays_verdict is pass and which has not moved."
    )
    options: CalibrationOptions = CalibrationOptions()


class ScheduleAsk(ScheduleSpec, Given):
    """A schedule that is to be kept."""

    options: GivenCalibrationOptions = GivenCalibrationOptions()


class ScheduleRun(Contract):
    """The outcome of one due time."""

    due_at: datetime
    outcome: ScheduleOutcome
    calibration_id: Identifier | None = None


class Schedule(Stamped, ScheduleSpec):
    """A schedule as it stands."""

    next_due_at: datetime | None = Field(description="Null when disabled.")
    last_run: ScheduleRun | None = None
