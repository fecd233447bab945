from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

from attrs import define as _attrs_define

if TYPE_CHECKING:
    from ..models.alarm import Alarm


T = TypeVar("T", bound="AlarmList")


@_attrs_define
class AlarmList:
    """The alarms that are open."""

    alarms: list[Alarm]
    """ By scanner; those that were closed are among the events. """

    def to_dict(self) -> dict[str, Any]:
        alarms = []
        for alarms_item_data in self.alarms:
            alarms_item = alarms_item_data.to_dict()
            alarms.append(alarms_item)

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "alarms": alarms,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.alarm import Alarm  # noqa: PLC0415

        d = dict(src_dict)
        alarms = []
        _alarms = d.pop("alarms")
        for alarms_item_data in _alarms:
            alarms_item = Alarm.from_dict(alarms_item_data)

            alarms.append(alarms_item)

        alarm_list = cls(
            alarms=alarms,
        )

        return alarm_list
