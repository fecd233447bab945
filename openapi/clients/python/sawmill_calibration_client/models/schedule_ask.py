from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

from attrs import define as _attrs_define

from ..models.on_pass import OnPass
from ..models.schedule_kind import ScheduleKind
from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.drift_options import DriftOptions
    from ..models.given_calibration_options import GivenCalibrationOptions


T = TypeVar("T", bound="ScheduleAsk")


@_attrs_define
class ScheduleAsk:
    """A schedule that is to be kept."""

    cron: str
    """ Five fields of cron, by the clocks of `time_zone`: minute, hour, day of the month, month, day of the week.
    Lists, ranges and steps, names of months and days, L and LW for the month's last day and working day. """
    scanner_id: str
    """ Id of the scanner that is recalibrated or looked at. """
    drift_options: DriftOptions | Unset = UNSET
    """ Which part of the scan is looked at. """
    enabled: bool | Unset = True
    """ False: nothing is due until it is enabled. """
    kind: ScheduleKind | Unset = UNSET
    """ recalibrate: with the newest phantom scan that no schedule has used. check-drift: on the newest log scan
    that no drift check has looked at. """
    on_pass: OnPass | Unset = UNSET
    """ report: nothing more is done. activate: it becomes active. """
    options: GivenCalibrationOptions | Unset = UNSET
    """ How to calibrate, as somebody asks for it; an earlier version took what is refused here. """
    time_zone: str | Unset = "UTC"
    """ The time zone of `cron`, by its name in the tz database. On the days when its clocks are put forward or
    back, an hour that `cron` names comes once; `*` stands for each hour that passes. """

    def to_dict(self) -> dict[str, Any]:
        cron = self.cron

        scanner_id = self.scanner_id

        drift_options: dict[str, Any] | Unset = UNSET
        if not isinstance(self.drift_options, Unset):
            drift_options = self.drift_options.to_dict()

        enabled = self.enabled

        kind: str | Unset = UNSET
        if not isinstance(self.kind, Unset):
            kind = self.kind.value

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
                "cron": cron,
                "scanner_id": scanner_id,
            }
        )
        if drift_options is not UNSET:
            field_dict["drift_options"] = drift_options
        if enabled is not UNSET:
            field_dict["enabled"] = enabled
        if kind is not UNSET:
            field_dict["kind"] = kind
        if on_pass is not UNSET:
            field_dict["on_pass"] = on_pass
        if options is not UNSET:
            field_dict["options"] = options
        if time_zone is not UNSET:
            field_dict["time_zone"] = time_zone

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.drift_options import DriftOptions  # noqa: PLC0415
        from ..models.given_calibration_options import GivenCalibrationOptions  # noqa: PLC0415

        d = dict(src_dict)
        cron = d.pop("cron")

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

        _on_pass = d.pop("on_pass", UNSET)
        on_pass: OnPass | Unset
        if isinstance(_on_pass, Unset):
            on_pass = UNSET
        else:
            on_pass = OnPass(_on_pass)

        _options = d.pop("options", UNSET)
        options: GivenCalibrationOptions | Unset
        if isinstance(_options, Unset):
            options = UNSET
        else:
            options = GivenCalibrationOptions.from_dict(_options)

        time_zone = d.pop("time_zone", UNSET)

        schedule_ask = cls(
            cron=cron,
            scanner_id=scanner_id,
            drift_options=drift_options,
            enabled=enabled,
            kind=kind,
            on_pass=on_pass,
            options=options,
            time_zone=time_zone,
        )

        return schedule_ask
