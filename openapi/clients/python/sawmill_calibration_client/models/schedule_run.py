from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.schedule_outcome import ScheduleOutcome
from ..types import UNSET, Unset

T = TypeVar("T", bound="ScheduleRun")


@_attrs_define
class ScheduleRun:
    """The outcome of one due time."""

    due_at: datetime.datetime
    """ The due time, RFC 3339, UTC. """
    outcome: ScheduleOutcome
    """ A job was queued, or there was no new scan for it, or no active calibration to compare a log with. """
    calibration_id: None | str | Unset = UNSET
    """ Id of the calibration that was queued. Null: none was. """
    drift_id: None | str | Unset = UNSET
    """ Id of the drift check that was queued. Null: none was. """

    def to_dict(self) -> dict[str, Any]:
        due_at = self.due_at.isoformat()

        outcome = self.outcome.value

        calibration_id: None | str | Unset
        if isinstance(self.calibration_id, Unset):
            calibration_id = UNSET
        else:
            calibration_id = self.calibration_id

        drift_id: None | str | Unset
        if isinstance(self.drift_id, Unset):
            drift_id = UNSET
        else:
            drift_id = self.drift_id

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "due_at": due_at,
                "outcome": outcome,
            }
        )
        if calibration_id is not UNSET:
            field_dict["calibration_id"] = calibration_id
        if drift_id is not UNSET:
            field_dict["drift_id"] = drift_id

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        due_at = datetime.datetime.fromisoformat(d.pop("due_at"))

        outcome = ScheduleOutcome(d.pop("outcome"))

        def _parse_calibration_id(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        calibration_id = _parse_calibration_id(d.pop("calibration_id", UNSET))

        def _parse_drift_id(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        drift_id = _parse_drift_id(d.pop("drift_id", UNSET))

        schedule_run = cls(
            due_at=due_at,
            outcome=outcome,
            calibration_id=calibration_id,
            drift_id=drift_id,
        )

        return schedule_run
