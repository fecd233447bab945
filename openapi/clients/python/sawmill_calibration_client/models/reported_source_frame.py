from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from attrs import define as _attrs_define

T = TypeVar("T", bound="ReportedSourceFrame")


@_attrs_define
class ReportedSourceFrame:
    """The geometry with the source on the axis, what the data can see, with its magnification."""

    cor_column_mm: float
    """ u_c, where the centre of rotation falls on the detector, mm from its middle. """
    magnification: float
    """ SDD / R, no unit. """
    psi_rad: float
    """ psi, first angle in the source frame, rad. """
    source_distance_mm: float
    """ R, source to centre of rotation along the axis, mm. """
    source_to_detector_mm: float
    """ SDD along the ray through the centre of rotation, mm. """
    tilt_rad: float
    """ tau, tilt of the detector against that ray's normal, rad. """

    def to_dict(self) -> dict[str, Any]:
        cor_column_mm = self.cor_column_mm

        magnification = self.magnification

        psi_rad = self.psi_rad

        source_distance_mm = self.source_distance_mm

        source_to_detector_mm = self.source_to_detector_mm

        tilt_rad = self.tilt_rad

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "cor_column_mm": cor_column_mm,
                "magnification": magnification,
                "psi_rad": psi_rad,
                "source_distance_mm": source_distance_mm,
                "source_to_detector_mm": source_to_detector_mm,
                "tilt_rad": tilt_rad,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        cor_column_mm = d.pop("cor_column_mm")

        magnification = d.pop("magnification")

        psi_rad = d.pop("psi_rad")

        source_distance_mm = d.pop("source_distance_mm")

        source_to_detector_mm = d.pop("source_to_detector_mm")

        tilt_rad = d.pop("tilt_rad")

        reported_source_frame = cls(
            cor_column_mm=cor_column_mm,
            magnification=magnification,
            psi_rad=psi_rad,
            source_distance_mm=source_distance_mm,
            source_to_detector_mm=source_to_detector_mm,
            tilt_rad=tilt_rad,
        )

        return reported_source_frame
