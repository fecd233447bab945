from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..types import UNSET, Unset

T = TypeVar("T", bound="ViewAngles")


@_attrs_define
class ViewAngles:
    """The angles that the views would have."""

    first_deg: float
    """ The first view's angle, degrees. """
    from_file: bool
    """ Whether the file carries them; else they are those given. """
    last_deg: float
    """ The last view's angle, degrees. """
    file_unit: None | str | Unset = UNSET
    """ The unit in which the file carries them. Null: it carries none, or states no unit. """

    def to_dict(self) -> dict[str, Any]:
        first_deg = self.first_deg

        from_file = self.from_file

        last_deg = self.last_deg

        file_unit: None | str | Unset
        if isinstance(self.file_unit, Unset):
            file_unit = UNSET
        else:
            file_unit = self.file_unit

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "first_deg": first_deg,
                "from_file": from_file,
                "last_deg": last_deg,
            }
        )
        if file_unit is not UNSET:
            field_dict["file_unit"] = file_unit

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        first_deg = d.pop("first_deg")

        from_file = d.pop("from_file")

        last_deg = d.pop("last_deg")

        def _parse_file_unit(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        file_unit = _parse_file_unit(d.pop("file_unit", UNSET))

        view_angles = cls(
            first_deg=first_deg,
            from_file=from_file,
            last_deg=last_deg,
            file_unit=file_unit,
        )

        return view_angles
