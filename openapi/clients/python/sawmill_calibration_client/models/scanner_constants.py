from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..types import UNSET, Unset

T = TypeVar("T", bound="ScannerConstants")


@_attrs_define
class ScannerConstants:
    """What is known of a scanner without calibrating it."""

    detector_pitch_mm: float
    """ Distance between neighbouring detector cells, mm. """
    num_detector_pixels: int
    """ n_D, number of detector cells. """
    source_to_cor_mm: float
    """ r_S, source to centre of rotation, mm. """
    row_pitch_mm: float | None | Unset = UNSET
    """ Distance between detector rows, mm. Left out where slices have no spacing. """

    def to_dict(self) -> dict[str, Any]:
        detector_pitch_mm = self.detector_pitch_mm

        num_detector_pixels = self.num_detector_pixels

        source_to_cor_mm = self.source_to_cor_mm

        row_pitch_mm: float | None | Unset
        if isinstance(self.row_pitch_mm, Unset):
            row_pitch_mm = UNSET
        else:
            row_pitch_mm = self.row_pitch_mm

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "detector_pitch_mm": detector_pitch_mm,
                "num_detector_pixels": num_detector_pixels,
                "source_to_cor_mm": source_to_cor_mm,
            }
        )
        if row_pitch_mm is not UNSET:
            field_dict["row_pitch_mm"] = row_pitch_mm

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        detector_pitch_mm = d.pop("detector_pitch_mm")

        num_detector_pixels = d.pop("num_detector_pixels")

        source_to_cor_mm = d.pop("source_to_cor_mm")

        def _parse_row_pitch_mm(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        row_pitch_mm = _parse_row_pitch_mm(d.pop("row_pitch_mm", UNSET))

        scanner_constants = cls(
            detector_pitch_mm=detector_pitch_mm,
            num_detector_pixels=num_detector_pixels,
            source_to_cor_mm=source_to_cor_mm,
            row_pitch_mm=row_pitch_mm,
        )

        return scanner_constants
