from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

from attrs import define as _attrs_define

from ..models.on_pass import OnPass
from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.given_calibration_options import GivenCalibrationOptions


T = TypeVar("T", bound="ScheduleAsk")


@_attrs_define
class ScheduleAsk:
    """A schedule that is to be kept."""

    cron: str
    """ Five fields of cron, in UTC: minute, hour, day of the month, month, day of the week. Lists, ranges and
    steps, names of months and days, L and LW for the month's last day and working day. """
    scanner_id: str
    """ Id of the scanner that is recalibrated. """
    enabled: bool | Unset = True
    """ False: nothing is due until it is enabled. """
    on_pass: OnPass | Unset = UNSET
    """ report: nothing more is done. activate: it becomes active. """
    options: GivenCalibrationOptions | Unset = UNSET
    """ How to calibrate, as somebody asks for it; an earlier version took what is refused here. """

    def to_dict(self) -> dict[str, Any]:
        cron = self.cron

        scanner_id = self.scanner_id

        enabled = self.enabled

        on_pass: str | Unset = UNSET
        if not isinstance(self.on_pass, Unset):
            on_pass = self.on_pass.value

        options: dict[str, Any] | Unset = UNSET
        if not isinstance(self.options, Unset):
            options = self.options.to_dict()

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "cron": cron,
                "scanner_id": scanner_id,
            }
        )
        if enabled is not UNSET:
            field_dict["enabled"] = enabled
        if on_pass is not UNSET:
            field_dict["on_pass"] = on_pass
        if options is not UNSET:
            field_dict["options"] = options

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.given_calibration_options import GivenCalibrationOptions  # noqa: PLC0415

        d = dict(src_dict)
        cron = d.pop("cron")

        scanner_id = d.pop("scanner_id")

        enabled = d.pop("enabled", UNSET)

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

        schedule_ask = cls(
            cron=cron,
            scanner_id=scanner_id,
            enabled=enabled,
            on_pass=on_pass,
            options=options,
        )

        return schedule_ask
