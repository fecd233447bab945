from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

T = TypeVar("T", bound="DetectorDeviation")


@_attrs_define
class DetectorDeviation:
    """A standard deviation of each, or how many of them; null for the distance where the scan does not show it."""

    cor_column_mm: float
    """ Of u_c, where the centre of rotation falls on the detector, mm, or a number of standard deviations. """
    source_to_detector_mm: float | None
    """ Of SDD, mm, or a number of standard deviations. Null: the scan does not show it. """
    tilt_rad: float
    """ Of tau, the detector's tilt, radians, or a number of standard deviations. """

    def to_dict(self) -> dict[str, Any]:
        cor_column_mm = self.cor_column_mm

        source_to_detector_mm: float | None
        source_to_detector_mm = self.source_to_detector_mm

        tilt_rad = self.tilt_rad

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "cor_column_mm": cor_column_mm,
                "source_to_detector_mm": source_to_detector_mm,
                "tilt_rad": tilt_rad,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        cor_column_mm = d.pop("cor_column_mm")

        def _parse_source_to_detector_mm(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        source_to_detector_mm = _parse_source_to_detector_mm(d.pop("source_to_detector_mm"))

        tilt_rad = d.pop("tilt_rad")

        detector_deviation = cls(
            cor_column_mm=cor_column_mm,
            source_to_detector_mm=source_to_detector_mm,
            tilt_rad=tilt_rad,
        )

        return detector_deviation
