from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..types import UNSET, Unset

T = TypeVar("T", bound="AlarmLimits")


@_attrs_define
class AlarmLimits:
    """After how long something that has not come opens an alarm. An expired phantom needs no limit."""

    phantom_scan_every_days: float | None | Unset = UNSET
    """ Number of days without a phantom scan. Null: no alarm. """
    quiet_after_hours: float | None | Unset = UNSET
    """ Number of hours without any scan. Null: no alarm. """

    def to_dict(self) -> dict[str, Any]:
        phantom_scan_every_days: float | None | Unset
        if isinstance(self.phantom_scan_every_days, Unset):
            phantom_scan_every_days = UNSET
        else:
            phantom_scan_every_days = self.phantom_scan_every_days

        quiet_after_hours: float | None | Unset
        if isinstance(self.quiet_after_hours, Unset):
            quiet_after_hours = UNSET
        else:
            quiet_after_hours = self.quiet_after_hours

        field_dict: dict[str, Any] = {}

        field_dict.update({})
        if phantom_scan_every_days is not UNSET:
            field_dict["phantom_scan_every_days"] = phantom_scan_every_days
        if quiet_after_hours is not UNSET:
            field_dict["quiet_after_hours"] = quiet_after_hours

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)

        def _parse_phantom_scan_every_days(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        phantom_scan_every_days = _parse_phantom_scan_every_days(d.pop("phantom_scan_every_days", UNSET))

        def _parse_quiet_after_hours(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        quiet_after_hours = _parse_quiet_after_hours(d.pop("quiet_after_hours", UNSET))

        alarm_limits = cls(
            phantom_scan_every_days=phantom_scan_every_days,
            quiet_after_hours=quiet_after_hours,
        )

        return alarm_limits
