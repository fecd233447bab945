from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

T = TypeVar("T", bound="ThetaDeviation")


@_attrs_define
class ThetaDeviation:
    """Standard deviations of theta; null where the source shift is not resolved."""

    detector_shift_mm: float | None
    """ Of h_D, mm. """
    detector_tilt: float | None
    """ Of alpha_D, a slope without unit. """
    detector_to_cor_mm: float | None
    """ Of r_D, mm. """
    initial_angle_rad: float | None
    """ Of alpha0, radians. """
    source_shift_mm: float | None
    """ Of h_S, mm. """

    def to_dict(self) -> dict[str, Any]:
        detector_shift_mm: float | None
        detector_shift_mm = self.detector_shift_mm

        detector_tilt: float | None
        detector_tilt = self.detector_tilt

        detector_to_cor_mm: float | None
        detector_to_cor_mm = self.detector_to_cor_mm

        initial_angle_rad: float | None
        initial_angle_rad = self.initial_angle_rad

        source_shift_mm: float | None
        source_shift_mm = self.source_shift_mm

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "detector_shift_mm": detector_shift_mm,
                "detector_tilt": detector_tilt,
                "detector_to_cor_mm": detector_to_cor_mm,
                "initial_angle_rad": initial_angle_rad,
                "source_shift_mm": source_shift_mm,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)

        def _parse_detector_shift_mm(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        detector_shift_mm = _parse_detector_shift_mm(d.pop("detector_shift_mm"))

        def _parse_detector_tilt(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        detector_tilt = _parse_detector_tilt(d.pop("detector_tilt"))

        def _parse_detector_to_cor_mm(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        detector_to_cor_mm = _parse_detector_to_cor_mm(d.pop("detector_to_cor_mm"))

        def _parse_initial_angle_rad(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        initial_angle_rad = _parse_initial_angle_rad(d.pop("initial_angle_rad"))

        def _parse_source_shift_mm(data: object) -> float | None:
            if data is None:
                return data
            return cast(float | None, data)

        source_shift_mm = _parse_source_shift_mm(d.pop("source_shift_mm"))

        theta_deviation = cls(
            detector_shift_mm=detector_shift_mm,
            detector_tilt=detector_tilt,
            detector_to_cor_mm=detector_to_cor_mm,
            initial_angle_rad=initial_angle_rad,
            source_shift_mm=source_shift_mm,
        )

        return theta_deviation
