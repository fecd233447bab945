from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, TypeVar, cast

from attrs import define as _attrs_define
from attrs import field as _attrs_field

from ..types import UNSET, Unset

T = TypeVar("T", bound="ScheduleAskType1")


@_attrs_define
class ScheduleAskType1:
    on_pass: Literal["report"] | Unset = UNSET
    additional_properties: dict[str, Any] = _attrs_field(init=False, factory=dict)

    def to_dict(self) -> dict[str, Any]:
        on_pass = self.on_pass

        field_dict: dict[str, Any] = {}
        field_dict.update(self.additional_properties)
        field_dict.update({})
        if on_pass is not UNSET:
            field_dict["on_pass"] = on_pass

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        on_pass = cast(Literal["report"] | Unset, d.pop("on_pass", UNSET))
        if on_pass != "report" and not isinstance(on_pass, Unset):
            raise ValueError(f"on_pass must match const 'report', got '{on_pass}'")

        schedule_ask_type_1 = cls(
            on_pass=on_pass,
        )

        schedule_ask_type_1.additional_properties = d
        return schedule_ask_type_1

    @property
    def additional_keys(self) -> list[str]:
        return list(self.additional_properties.keys())

    def __getitem__(self, key: str) -> Any:
        return self.additional_properties[key]

    def __setitem__(self, key: str, value: Any) -> None:
        self.additional_properties[key] = value

    def __delitem__(self, key: str) -> None:
        del self.additional_properties[key]

    def __contains__(self, key: str) -> bool:
        return key in self.additional_properties
