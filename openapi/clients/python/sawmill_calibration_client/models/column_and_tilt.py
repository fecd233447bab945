from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from attrs import define as _attrs_define

T = TypeVar("T", bound="ColumnAndTilt")


@_attrs_define
class ColumnAndTilt:
    """What the phantom's rows and the log's rows both show."""

    cor_column_mm: float
    """ u_c, where the centre of rotation falls on the detector, mm from its middle. """
    tilt_rad: float
    """ tau, tilt of the detector against the ray through the centre of rotation, radians. """

    def to_dict(self) -> dict[str, Any]:
        cor_column_mm = self.cor_column_mm

        tilt_rad = self.tilt_rad

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "cor_column_mm": cor_column_mm,
                "tilt_rad": tilt_rad,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        cor_column_mm = d.pop("cor_column_mm")

        tilt_rad = d.pop("tilt_rad")

        column_and_tilt = cls(
            cor_column_mm=cor_column_mm,
            tilt_rad=tilt_rad,
        )

        return column_and_tilt
