from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from attrs import define as _attrs_define

T = TypeVar("T", bound="DetectorGeometry")


@_attrs_define
class DetectorGeometry:
    """The part of the geometry that a log shows."""

    cor_column_mm: float
    """ u_c, where the centre of rotation falls on the detector. In mm. """
    source_to_detector_mm: float
    """ SDD along that ray; only weakly seen, and held where it is not. In mm. """
    tilt_rad: float
    """ tau, tilt of the detector against the ray through the centre of rotation. In rad. """

    def to_dict(self) -> dict[str, Any]:
        cor_column_mm = self.cor_column_mm

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

        source_to_detector_mm = d.pop("source_to_detector_mm")

        tilt_rad = d.pop("tilt_rad")

        detector_geometry = cls(
            cor_column_mm=cor_column_mm,
            source_to_detector_mm=source_to_detector_mm,
            tilt_rad=tilt_rad,
        )

        return detector_geometry
