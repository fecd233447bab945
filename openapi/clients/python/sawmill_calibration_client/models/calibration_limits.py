from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..types import UNSET, Unset

T = TypeVar("T", bound="CalibrationLimits")


@_attrs_define
class CalibrationLimits:
    """What an answer is held against, where no scanner is registered that has tolerances."""

    log_radius_mm: float | None | Unset = UNSET
    """ Radius of the disc in which ray errors are counted, mm. Null: that of the smallest disc which holds the
    phantom. """
    scale_tolerance_percent: float | Unset = 0.5
    """ What the image's millimetres may be off by, per cent. """
    tolerance_mm: float | Unset = 0.1
    """ What the predicted ray error may be, mm. """

    def to_dict(self) -> dict[str, Any]:
        log_radius_mm: float | None | Unset
        if isinstance(self.log_radius_mm, Unset):
            log_radius_mm = UNSET
        else:
            log_radius_mm = self.log_radius_mm

        scale_tolerance_percent = self.scale_tolerance_percent

        tolerance_mm = self.tolerance_mm

        field_dict: dict[str, Any] = {}

        field_dict.update({})
        if log_radius_mm is not UNSET:
            field_dict["log_radius_mm"] = log_radius_mm
        if scale_tolerance_percent is not UNSET:
            field_dict["scale_tolerance_percent"] = scale_tolerance_percent
        if tolerance_mm is not UNSET:
            field_dict["tolerance_mm"] = tolerance_mm

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)

        def _parse_log_radius_mm(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        log_radius_mm = _parse_log_radius_mm(d.pop("log_radius_mm", UNSET))

        scale_tolerance_percent = d.pop("scale_tolerance_percent", UNSET)

        tolerance_mm = d.pop("tolerance_mm", UNSET)

        calibration_limits = cls(
            log_radius_mm=log_radius_mm,
            scale_tolerance_percent=scale_tolerance_percent,
            tolerance_mm=tolerance_mm,
        )

        return calibration_limits
