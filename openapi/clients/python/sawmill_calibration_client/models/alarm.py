from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.alarm_kind import AlarmKind
from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.drift_finding import DriftFinding


T = TypeVar("T", bound="Alarm")


@_attrs_define
class Alarm:
    """Something that a scanner waits for; it is closed by itself when that has come."""

    scanner_id: str
    """ Id of the scanner. """
    since: datetime.datetime
    """ When the limit was passed, RFC 3339, UTC; a day ends at midnight UTC. Of a drift when the log was looked at
    that showed it. """
    what: AlarmKind
    """ What is missing, or was seen. """
    drift: DriftFinding | None | Unset = UNSET
    """ What the logs showed when it was opened. Null: it is of no drift. """
    expired_on: datetime.date | None | Unset = UNSET
    """ The last day of its measurement. Null: it is of no phantom. """
    last_at: datetime.datetime | None | Unset = UNSET
    """ When the last one came that is known or, if none is, the scanner was added. Null: it is of a phantom or a
    drift. """
    limit_hours: float | None | Unset = UNSET
    """ The scanner's limit, a number of hours. Null: it is of a phantom or a drift. """
    phantom_id: None | str | Unset = UNSET
    """ Id of the phantom that was to be measured again. Null: it is of no phantom. """

    def to_dict(self) -> dict[str, Any]:
        from ..models.drift_finding import DriftFinding  # noqa: PLC0415

        scanner_id = self.scanner_id

        since = self.since.isoformat()

        what = self.what.value

        drift: dict[str, Any] | None | Unset
        if isinstance(self.drift, Unset):
            drift = UNSET
        elif isinstance(self.drift, DriftFinding):
            drift = self.drift.to_dict()
        else:
            drift = self.drift

        expired_on: None | str | Unset
        if isinstance(self.expired_on, Unset):
            expired_on = UNSET
        elif isinstance(self.expired_on, datetime.date):
            expired_on = self.expired_on.isoformat()
        else:
            expired_on = self.expired_on

        last_at: None | str | Unset
        if isinstance(self.last_at, Unset):
            last_at = UNSET
        elif isinstance(self.last_at, datetime.datetime):
            last_at = self.last_at.isoformat()
        else:
            last_at = self.last_at

        limit_hours: float | None | Unset
        if isinstance(self.limit_hours, Unset):
            limit_hours = UNSET
        else:
            limit_hours = self.limit_hours

        phantom_id: None | str | Unset
        if isinstance(self.phantom_id, Unset):
            phantom_id = UNSET
        else:
            phantom_id = self.phantom_id

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "scanner_id": scanner_id,
                "since": since,
                "what": what,
            }
        )
        if drift is not UNSET:
            field_dict["drift"] = drift
        if expired_on is not UNSET:
            field_dict["expired_on"] = expired_on
        if last_at is not UNSET:
            field_dict["last_at"] = last_at
        if limit_hours is not UNSET:
            field_dict["limit_hours"] = limit_hours
        if phantom_id is not UNSET:
            field_dict["phantom_id"] = phantom_id

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.drift_finding import DriftFinding  # noqa: PLC0415

        d = dict(src_dict)
        scanner_id = d.pop("scanner_id")

        since = datetime.datetime.fromisoformat(d.pop("since"))

        what = AlarmKind(d.pop("what"))

        def _parse_drift(data: object) -> DriftFinding | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                drift_type_0 = DriftFinding.from_dict(data)

                return drift_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(DriftFinding | None | Unset, data)

        drift = _parse_drift(d.pop("drift", UNSET))

        def _parse_expired_on(data: object) -> datetime.date | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                expired_on_type_0 = datetime.date.fromisoformat(data)

                return expired_on_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(datetime.date | None | Unset, data)

        expired_on = _parse_expired_on(d.pop("expired_on", UNSET))

        def _parse_last_at(data: object) -> datetime.datetime | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                last_at_type_0 = datetime.datetime.fromisoformat(data)

                return last_at_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(datetime.datetime | None | Unset, data)

        last_at = _parse_last_at(d.pop("last_at", UNSET))

        def _parse_limit_hours(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        limit_hours = _parse_limit_hours(d.pop("limit_hours", UNSET))

        def _parse_phantom_id(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        phantom_id = _parse_phantom_id(d.pop("phantom_id", UNSET))

        alarm = cls(
            scanner_id=scanner_id,
            since=since,
            what=what,
            drift=drift,
            expired_on=expired_on,
            last_at=last_at,
            limit_hours=limit_hours,
            phantom_id=phantom_id,
        )

        return alarm
