from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

T = TypeVar("T", bound="SourceFrameDeviation")


@_attrs_define
class SourceFrameDeviation:
    """Standard deviations of the source frame; null for a parameter that was held fixed."""

    cor_column_mm: float | None
    """ Of u_c, mm. """
    magnification: float | None
    """ Of the magnification, no unit. """
    psi_rad: float | None
    """ Of psi, radians. """
    source_distance_mm: float | None
    """ Of R, mm. """
    source_to_detector_mm: float | None
    """ Of SDD, mm. """
    tilt_rad: float | None
    """ Of tau, radians. """

    def to_dict(self) -> dict[str, Any]:
        cor_column_mm: float | None
        cor_column_mm = self.cor_column_mm

        magnification: float | None
        magnification = self.magnification

        psi_rad: float | None
        psi_rad = self.psi_rad

        source_distance_mm: float | None
        source_distance_mm = self.source_distance_mm

        source_to_detector_mm: float | None
        source_to_detector_mm = self.source_to_detector_mm

        tilt_rad: float | None
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

        def _parse_cor_column_mm(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        cor_column_mm = _parse_cor_column_mm(d.pop("cor_column_mm"))

        def _parse_magnification(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        magnification = _parse_magnification(d.pop("magnification"))

        def _parse_psi_rad(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        psi_rad = _parse_psi_rad(d.pop("psi_rad"))

        def _parse_source_distance_mm(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        source_distance_mm = _parse_source_distance_mm(d.pop("source_distance_mm"))

        def _parse_source_to_detector_mm(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        source_to_detector_mm = _parse_source_to_detector_mm(d.pop("source_to_detector_mm"))

        def _parse_tilt_rad(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        tilt_rad = _parse_tilt_rad(d.pop("tilt_rad"))

        source_frame_deviation = cls(
            cor_column_mm=cor_column_mm,
            magnification=magnification,
            psi_rad=psi_rad,
            source_distance_mm=source_distance_mm,
            source_to_detector_mm=source_to_detector_mm,
            tilt_rad=tilt_rad,
        )

        return source_frame_deviation
