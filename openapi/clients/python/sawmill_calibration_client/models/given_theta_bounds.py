from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..types import UNSET, Unset

T = TypeVar("T", bound="GivenThetaBounds")


@_attrs_define
class GivenThetaBounds:
    """Where somebody wants theta to be searched: within what a scanner can be."""

    detector_shift_mm: list[float] | Unset = UNSET
    """ Lowest and highest h_D, mm. """
    detector_tilt: list[float] | Unset = UNSET
    """ Lowest and highest alpha_D, a slope without unit. """
    detector_to_cor_mm: list[float] | Unset = UNSET
    """ Lowest and highest r_D, mm. """
    source_shift_mm: list[float] | Unset = UNSET
    """ Lowest and highest h_S, mm. """

    def to_dict(self) -> dict[str, Any]:
        detector_shift_mm: list[float] | Unset = UNSET
        if not isinstance(self.detector_shift_mm, Unset):
            detector_shift_mm = []
            for detector_shift_mm_item_data in self.detector_shift_mm:
                detector_shift_mm_item: float
                detector_shift_mm_item = detector_shift_mm_item_data
                detector_shift_mm.append(detector_shift_mm_item)

        detector_tilt: list[float] | Unset = UNSET
        if not isinstance(self.detector_tilt, Unset):
            detector_tilt = []
            for detector_tilt_item_data in self.detector_tilt:
                detector_tilt_item: float
                detector_tilt_item = detector_tilt_item_data
                detector_tilt.append(detector_tilt_item)

        detector_to_cor_mm: list[float] | Unset = UNSET
        if not isinstance(self.detector_to_cor_mm, Unset):
            detector_to_cor_mm = []
            for detector_to_cor_mm_item_data in self.detector_to_cor_mm:
                detector_to_cor_mm_item: float
                detector_to_cor_mm_item = detector_to_cor_mm_item_data
                detector_to_cor_mm.append(detector_to_cor_mm_item)

        source_shift_mm: list[float] | Unset = UNSET
        if not isinstance(self.source_shift_mm, Unset):
            source_shift_mm = []
            for source_shift_mm_item_data in self.source_shift_mm:
                source_shift_mm_item: float
                source_shift_mm_item = source_shift_mm_item_data
                source_shift_mm.append(source_shift_mm_item)

        field_dict: dict[str, Any] = {}

        field_dict.update({})
        if detector_shift_mm is not UNSET:
            field_dict["detector_shift_mm"] = detector_shift_mm
        if detector_tilt is not UNSET:
            field_dict["detector_tilt"] = detector_tilt
        if detector_to_cor_mm is not UNSET:
            field_dict["detector_to_cor_mm"] = detector_to_cor_mm
        if source_shift_mm is not UNSET:
            field_dict["source_shift_mm"] = source_shift_mm

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        _detector_shift_mm = d.pop("detector_shift_mm", UNSET)
        detector_shift_mm: list[float] | Unset = UNSET
        if _detector_shift_mm is not UNSET:
            detector_shift_mm = []
            for detector_shift_mm_item_data in _detector_shift_mm:

                def _parse_detector_shift_mm_item(data: object) -> float:
                    return cast(float, data)

                detector_shift_mm_item = _parse_detector_shift_mm_item(detector_shift_mm_item_data)

                detector_shift_mm.append(detector_shift_mm_item)

        _detector_tilt = d.pop("detector_tilt", UNSET)
        detector_tilt: list[float] | Unset = UNSET
        if _detector_tilt is not UNSET:
            detector_tilt = []
            for detector_tilt_item_data in _detector_tilt:

                def _parse_detector_tilt_item(data: object) -> float:
                    return cast(float, data)

                detector_tilt_item = _parse_detector_tilt_item(detector_tilt_item_data)

                detector_tilt.append(detector_tilt_item)

        _detector_to_cor_mm = d.pop("detector_to_cor_mm", UNSET)
        detector_to_cor_mm: list[float] | Unset = UNSET
        if _detector_to_cor_mm is not UNSET:
            detector_to_cor_mm = []
            for detector_to_cor_mm_item_data in _detector_to_cor_mm:

                def _parse_detector_to_cor_mm_item(data: object) -> float:
                    return cast(float, data)

                detector_to_cor_mm_item = _parse_detector_to_cor_mm_item(detector_to_cor_mm_item_data)

                detector_to_cor_mm.append(detector_to_cor_mm_item)

        _source_shift_mm = d.pop("source_shift_mm", UNSET)
        source_shift_mm: list[float] | Unset = UNSET
        if _source_shift_mm is not UNSET:
            source_shift_mm = []
            for source_shift_mm_item_data in _source_shift_mm:

                def _parse_source_shift_mm_item(data: object) -> float:
                    return cast(float, data)

                source_shift_mm_item = _parse_source_shift_mm_item(source_shift_mm_item_data)

                source_shift_mm.append(source_shift_mm_item)

        given_theta_bounds = cls(
            detector_shift_mm=detector_shift_mm,
            detector_tilt=detector_tilt,
            detector_to_cor_mm=detector_to_cor_mm,
            source_shift_mm=source_shift_mm,
        )

        return given_theta_bounds
