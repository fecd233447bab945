from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..types import UNSET, Unset

T = TypeVar("T", bound="DriftOptions")


@_attrs_define
class DriftOptions:
    """Which part of the scan is looked at."""

    rows: None | str | Unset = UNSET
    """ Detector rows A:B to average, the first included, the last not. By default all of them. A scan that came as
    the mean of rows has no others. """

    def to_dict(self) -> dict[str, Any]:
        rows: None | str | Unset
        if isinstance(self.rows, Unset):
            rows = UNSET
        else:
            rows = self.rows

        field_dict: dict[str, Any] = {}

        field_dict.update({})
        if rows is not UNSET:
            field_dict["rows"] = rows

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)

        def _parse_rows(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        rows = _parse_rows(d.pop("rows", UNSET))

        drift_options = cls(
            rows=rows,
        )

        return drift_options
