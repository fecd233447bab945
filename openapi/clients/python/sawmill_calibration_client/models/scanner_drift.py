from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

from attrs import define as _attrs_define

if TYPE_CHECKING:
    from ..models.pooled_drift import PooledDrift


T = TypeVar("T", bound="ScannerDrift")


@_attrs_define
class ScannerDrift:
    """The charts of a scanner since its active calibration."""

    charts: list[PooledDrift]
    """ By method; none before the first drift check that counts. """

    def to_dict(self) -> dict[str, Any]:
        charts = []
        for charts_item_data in self.charts:
            charts_item = charts_item_data.to_dict()
            charts.append(charts_item)

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "charts": charts,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.pooled_drift import PooledDrift  # noqa: PLC0415

        d = dict(src_dict)
        charts = []
        _charts = d.pop("charts")
        for charts_item_data in _charts:
            charts_item = PooledDrift.from_dict(charts_item_data)

            charts.append(charts_item)

        scanner_drift = cls(
            charts=charts,
        )

        return scanner_drift
