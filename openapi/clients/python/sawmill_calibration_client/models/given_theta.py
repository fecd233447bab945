from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from attrs import define as _attrs_define

T = TypeVar("T", bound="GivenTheta")


@_attrs_define
class GivenTheta:
    """A theta as somebody gives it: within what a scanner can be, source and detector on either side of the COR."""

    detector_shift_mm: float
    """ h_D, sideways shift of the detector, mm, counted the other way than h_S. """
    detector_tilt: float
    """ alpha_D, a slope without unit: the tilt angle is its arctangent. """
    detector_to_cor_mm: float
    """ r_D, detector to centre of rotation, mm; the source stands on the other side. """
    initial_angle_rad: float
    """ alpha0, rad; counts modulo 2 pi. """
    source_shift_mm: float
    """ h_S, sideways shift of the source, mm. """

    def to_dict(self) -> dict[str, Any]:
        detector_shift_mm = self.detector_shift_mm

        detector_tilt = self.detector_tilt

        detector_to_cor_mm = self.detector_to_cor_mm

        initial_angle_rad = self.initial_angle_rad

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
        detector_shift_mm = d.pop("detector_shift_mm")

        detector_tilt = d.pop("detector_tilt")

        detector_to_cor_mm = d.pop("detector_to_cor_mm")

        initial_angle_rad = d.pop("initial_angle_rad")

        source_shift_mm = d.pop("source_shift_mm")

        given_theta = cls(
            detector_shift_mm=detector_shift_mm,
            detector_tilt=detector_tilt,
            detector_to_cor_mm=detector_to_cor_mm,
            initial_angle_rad=initial_angle_rad,
            source_shift_mm=source_shift_mm,
        )

        return given_theta
