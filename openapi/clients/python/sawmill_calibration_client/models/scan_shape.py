from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from attrs import define as _attrs_define

T = TypeVar("T", bound="ScanShape")


@_attrs_define
class ScanShape:
    """Of the projection stack (view, row, detector)."""

    detector: int
    """ Number of detector cells. """
    rows: int
    """ Number of detector rows. """
    views: int
    """ Number of views. """

    def to_dict(self) -> dict[str, Any]:
        detector = self.detector

        rows = self.rows

        views = self.views

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "detector": detector,
                "rows": rows,
                "views": views,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        detector = d.pop("detector")

        rows = d.pop("rows")

        views = d.pop("views")

        scan_shape = cls(
            detector=detector,
            rows=rows,
            views=views,
        )

        return scan_shape
