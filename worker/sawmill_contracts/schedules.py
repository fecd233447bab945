"""Scheduled recalibration and drift checks."""

from datetime import datetime
from typing import Self

from pydantic import ConfigDict, Field, model_validator

from sawmill_contracts.calibrations import CalibrationOptions, GivenCalibrationOptions
from sawmill_contracts.choices import OnPass, ScheduleKind, ScheduleOutcome
from sawmill_contracts.drifts import DriftOptions
from sawmill_platform.contracts import patterns
from sawmill_platform.contracts.base import Contract, Identifier, Stamped
from sawmill_platform.contracts.given import Given
from sawmill_platform.contracts.kind_declarations import Schema, one_of, require


class ScheduleSpec(Contract):
    """Times at which a scanner is recalibrated with its newest phantom scan, or its newest log is checked for drift."""

    scanner_id: Identifier = Field(description="Id of the scanner.")
    kind: ScheduleKind = Field("recalibrate", description="Work at each due time.")
    cron: str = Field(
        max_length=100,
        description="Five fields of cron, in `time_zone`: minute, hour, day of the month, month, day of the week. "
        "Lists, ranges and steps, names of months and days, L and LW for the month's last day and working day.",
        examples=["30 5 * * 1-6"],
        json_schema_extra={"pattern": patterns.CRON},
    )
    time_zone: str = Field(
        default="UTC",
        max_length=64,
        description="Time zone of `cron`, by its name in the tz database. On the days when the clocks change, an "
        "hour that `cron` names comes once; `*` represents each hour that passes.",
        examples=["Europe/Helsinki"],
        json_schema_extra={"pattern": patterns.TIME_ZONE},
    )
    enabled: bool = Field(
        default=True, description="Whether the schedule runs; false: nothing is due until it is enabled."
    )
    on_pass: OnPass = Field(
        "report",
        description="Action of `recalibrate` on a calibration whose rays_verdict is pass and which has not moved.",
    )
    options: CalibrationOptions = Field(
        CalibrationOptions(), description="Options of its calibrations; `check-drift` does not use them."
    )
    drift_options: DriftOptions = Field(
        DriftOptions(), description="Options of its drift checks; `recalibrate` does not use them."
    )


def _state_what_activates(schema: Schema) -> None:
    require(schema, "on_pass", one_of("on_pass", ["report"]), one_of("kind", ["recalibrate"], default="recalibrate"))


class ScheduleRequest(ScheduleSpec, Given):
    """A schedule to be stored."""

    model_config = ConfigDict(json_schema_extra=_state_what_activates)

    options: GivenCalibrationOptions = Field(
        GivenCalibrationOptions(), description="Options of its calibrations; `check-drift` does not use them."
    )

    @model_validator(mode="after")
    def _activates_what_it_makes(self) -> Self:
        if self.kind != "recalibrate" and self.on_pass == "activate":  # noqa: S105 - no password
            raise ValueError(f"on_pass {self.on_pass!r} belongs to kind 'recalibrate', not {self.kind!r}: leave it out")
        return self


class ScheduleRun(Contract):
    """Outcome of one due time."""

    due_at: datetime = Field(description="The due time, RFC 3339, UTC.", examples=["2026-03-02T05:30:00Z"])
    outcome: ScheduleOutcome = Field(description="Whether a job was queued, else why not.", examples=["queued"])
    calibration_id: Identifier | None = Field(
        None, description="Id of the calibration that was queued. Null: no calibration was queued."
    )
    drift_id: Identifier | None = Field(
        None, description="Id of the drift check that was queued. Null: no drift check was queued."
    )


class Schedule(Stamped, ScheduleSpec):
    """A schedule in its present state."""

    next_due_at: datetime | None = Field(
        description="Next due time, RFC 3339, UTC. Null when disabled.", examples=["2026-03-03T05:30:00Z"]
    )
    last_run: ScheduleRun | None = Field(None, description="Outcome of the last due time. Null: there has been none.")
