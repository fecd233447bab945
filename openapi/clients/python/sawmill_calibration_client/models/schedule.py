from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.on_pass import OnPass
from ..models.schedule_kind import ScheduleKind
from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.calibration_options import CalibrationOptions
    from ..models.drift_options import DriftOptions
    from ..models.schedule_run import ScheduleRun


T = TypeVar("T", bound="Schedule")


@_attrs_define
class Schedule:
    """A schedule as it stands."""

    created_at: datetime.datetime
    """ When it was created, RFC 3339, UTC. """
    cron: str
    """ Five fields of cron, by the clocks of `time_zone`: minute, hour, day of the month, month, day of the week.
    Lists, ranges and steps, names of months and days, L and LW for the month's last day and working day. """
    id: str
    """ The resource's id, which the service gives. """
    next_due_at: datetime.datetime | None
    """ Null when disabled. """
    scanner_id: str
    """ Id of the scanner that is recalibrated or looked at. """
    drift_options: DriftOptions | Unset = UNSET
    """ Which part of the scan is looked at. """
    enabled: bool | Unset = True
    """ False: nothing is due until it is enabled. """
    kind: ScheduleKind | Unset = UNSET
    """ recalibrate: with the newest phantom scan that no schedule has used. check-drift: on the newest log scan
    that no drift check has looked at. """
    last_run: None | ScheduleRun | Unset = UNSET
    """ The outcome of the last due time. Null: none has come. """
    on_pass: OnPass | Unset = UNSET
    """ report: nothing more is done. activate: it becomes active. """
    options: CalibrationOptions | Unset = UNSET
    """ How to calibrate, apart from what. """
    time_zone: str | Unset = "UTC"
    """ The time zone of `cron`, by its name in the tz database. On the days when its clocks are put forward or
    back, an hour that `cron` names comes once; `*` stands for each hour that passes. """

    def to_dict(self) -> dict[str, Any]:
        from ..models.schedule_run import ScheduleRun  # noqa: PLC0415

        created_at = self.created_at.isoformat()

        cron = self.cron

        id = self.id

        next_due_at: None | str
        if isinstance(self.next_due_at, datetime.datetime):
            next_due_at = self.next_due_at.isoformat()
        else:
            next_due_at = self.next_due_at

        scanner_id = self.scanner_id

        drift_options: dict[str, Any] | Unset = UNSET
        if not isinstance(self.drift_options, Unset):
            drift_options = self.drift_options.to_dict()

        enabled = self.enabled

        kind: str | Unset = UNSET
        if not isinstance(self.kind, Unset):
            kind = self.kind.value

        last_run: dict[str, Any] | None | Unset
        if isinstance(self.last_run, Unset):
            last_run = UNSET
        elif isinstance(self.last_run, ScheduleRun):
            last_run = self.last_run.to_dict()
        else:
            last_run = self.last_run

        on_pass: str | Unset = UNSET
        if not isinstance(self.on_pass, Unset):
            on_pass = self.on_pass.value

        options: dict[str, Any] | Unset = UNSET
        if not isinstance(self.options, Unset):
            options = self.options.to_dict()

        time_zone = self.time_zone

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "created_at": created_at,
                "cron": cron,
                "id": id,
                "next_due_at": next_due_at,
                "scanner_id": scanner_id,
            }
        )
        if drift_options is not UNSET:
            field_dict["drift_options"] = drift_options
        if enabled is not UNSET:
            field_dict["enabled"] = enabled
        if kind is not UNSET:
            field_dict["kind"] = kind
        if last_run is not UNSET:
            field_dict["last_run"] = last_run
        if on_pass is not UNSET:
            field_dict["on_pass"] = on_pass
        if options is not UNSET:
            field_dict["options"] = options
        if time_zone is not UNSET:
            field_dict["time_zone"] = time_zone

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.calibration_options import CalibrationOptions  # noqa: PLC0415
        from ..models.drift_options import DriftOptions  # noqa: PLC0415
        from ..models.schedule_run import ScheduleRun  # noqa: PLC0415

        d = dict(src_dict)
        created_at = datetime.datetime.fromisoformat(d.pop("created_at"))

        cron = d.pop("cron")

        id = d.pop("id")

        def _parse_next_due_at(data: object) -> datetime.datetime | None:
            if data is None:
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                next_due_at_type_0 = datetime.datetime.fromisoformat(data)

                return next_due_at_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(datetime.datetime | None, data)

        next_due_at = _parse_next_due_at(d.pop("next_due_at"))

        scanner_id = d.pop("scanner_id")

        _drift_options = d.pop("drift_options", UNSET)
        drift_options: DriftOptions | Unset
        if isinstance(_drift_options, Unset):
            drift_options = UNSET
        else:
            drift_options = DriftOptions.from_dict(_drift_options)

        enabled = d.pop("enabled", UNSET)

        _kind = d.pop("kind", UNSET)
        kind: ScheduleKind | Unset
        if isinstance(_kind, Unset):
            kind = UNSET
        else:
            kind = ScheduleKind(_kind)

        def _parse_last_run(data: object) -> None | ScheduleRun | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                last_run_type_0 = ScheduleRun.from_dict(data)

                return last_run_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(None | ScheduleRun | Unset, data)

        last_run = _parse_last_run(d.pop("last_run", UNSET))

        _on_pass = d.pop("on_pass", UNSET)
        on_pass: OnPass | Unset
        if isinstance(_on_pass, Unset):
            on_pass = UNSET
        else:
            on_pass = OnPass(_on_pass)

        _options = d.pop("options", UNSET)
        options: CalibrationOptions | Unset
        if isinstance(_options, Unset):
            options = UNSET
        else:
            options = CalibrationOptions.from_dict(_options)

        time_zone = d.pop("time_zone", UNSET)

        schedule = cls(
            created_at=created_at,
            cron=cron,
            id=id,
            next_due_at=next_due_at,
            scanner_id=scanner_id,
            drift_options=drift_options,
            enabled=enabled,
            kind=kind,
            last_run=last_run,
            on_pass=on_pass,
            options=options,
            time_zone=time_zone,
        )

        return schedule
