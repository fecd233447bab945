from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..types import UNSET, Unset

T = TypeVar("T", bound="DriftAsk")


@_attrs_define
class DriftAsk:
    """Ask whether a scanner has moved since a calibration. The scan needs 8 views or more, of any log."""

    scan_id: str
    """ Id of the scan to look at. """
    calibration_id: None | str | Unset = UNSET
    """ To compare with; null: the scanner's active calibration. """
    fresh: bool | Unset = False
    """ Compute it even where the same was computed before, of the same input, with the same parameters and the same
    version of the software. Otherwise that result answers at once, and `answered_from` names it. """
    rows: None | str | Unset = UNSET
    """ Detector rows A:B to average, the first included, the last not. By default all of them. A scan that came as
    the mean of rows has no others. """

    def to_dict(self) -> dict[str, Any]:
        scan_id = self.scan_id

        calibration_id: None | str | Unset
        if isinstance(self.calibration_id, Unset):
            calibration_id = UNSET
        else:
            calibration_id = self.calibration_id

        fresh = self.fresh

        rows: None | str | Unset
        if isinstance(self.rows, Unset):
            rows = UNSET
        else:
            rows = self.rows

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "scan_id": scan_id,
            }
        )
        if calibration_id is not UNSET:
            field_dict["calibration_id"] = calibration_id
        if fresh is not UNSET:
            field_dict["fresh"] = fresh
        if rows is not UNSET:
            field_dict["rows"] = rows

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        scan_id = d.pop("scan_id")

        def _parse_calibration_id(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        calibration_id = _parse_calibration_id(d.pop("calibration_id", UNSET))

        fresh = d.pop("fresh", UNSET)

        def _parse_rows(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        rows = _parse_rows(d.pop("rows", UNSET))

        drift_ask = cls(
            scan_id=scan_id,
            calibration_id=calibration_id,
            fresh=fresh,
            rows=rows,
        )

        return drift_ask
