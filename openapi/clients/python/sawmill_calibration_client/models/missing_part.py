from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..types import UNSET, Unset

T = TypeVar("T", bound="MissingPart")


@_attrs_define
class MissingPart:
    """What the file does not carry, and how to give it."""

    flag: str
    """ Of the command line, which gives it. """
    what: str
    """ What is missing, in words. """
    why: str
    """ Why it must be given, in words. """
    field: None | str | Unset = UNSET
    """ What gives it to the service: a parameter of `POST /v1/scans`, or for a pitch or a distance one of the
    scanner's constants. Null: nothing does, and the file must carry it. """
    needed: bool | Unset = True
    """ Whether nothing can be read, or calibrated, without it. """

    def to_dict(self) -> dict[str, Any]:
        flag = self.flag

        what = self.what

        why = self.why

        field: None | str | Unset
        if isinstance(self.field, Unset):
            field = UNSET
        else:
            field = self.field

        needed = self.needed

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "flag": flag,
                "what": what,
                "why": why,
            }
        )
        if field is not UNSET:
            field_dict["field"] = field
        if needed is not UNSET:
            field_dict["needed"] = needed

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        flag = d.pop("flag")

        what = d.pop("what")

        why = d.pop("why")

        def _parse_field(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        field = _parse_field(d.pop("field", UNSET))

        needed = d.pop("needed", UNSET)

        missing_part = cls(
            flag=flag,
            what=what,
            why=why,
            field=field,
            needed=needed,
        )

        return missing_part
