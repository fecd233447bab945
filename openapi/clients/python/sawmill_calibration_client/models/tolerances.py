from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..types import UNSET, Unset

T = TypeVar("T", bound="Tolerances")


@_attrs_define
class Tolerances:
    """What the mill accepts. A calibration beyond one of them is not a pass."""

    angle_change_deg: float | None | Unset = UNSET
    """ Change of the first angle up to which nothing moved; null: it turns with the phantom's mounting. In degrees.
    """
    predicted_ray_error_mm: float | Unset = 0.1
    """ A calibration passes where its predicted ray error is below this with 95 % (`upper_95`), and is to be
    watched where only the RMS is. In mm. """
    ray_change_mm: float | Unset = 0.5
    """ RMS ray distance between two calibrations up to which nothing moved. In mm. """
    scale_percent: float | Unset = 0.5
    """ What the image's millimetres may be off by: a calibration whose `scale_uncertainty_percent` (95 %) is beyond
    it is to be watched, and a change of scale between two calibrations beyond it is a movement. """

    def to_dict(self) -> dict[str, Any]:
        angle_change_deg: float | None | Unset
        if isinstance(self.angle_change_deg, Unset):
            angle_change_deg = UNSET
        else:
            angle_change_deg = self.angle_change_deg

        predicted_ray_error_mm = self.predicted_ray_error_mm

        ray_change_mm = self.ray_change_mm

        scale_percent = self.scale_percent

        field_dict: dict[str, Any] = {}

        field_dict.update({})
        if angle_change_deg is not UNSET:
            field_dict["angle_change_deg"] = angle_change_deg
        if predicted_ray_error_mm is not UNSET:
            field_dict["predicted_ray_error_mm"] = predicted_ray_error_mm
        if ray_change_mm is not UNSET:
            field_dict["ray_change_mm"] = ray_change_mm
        if scale_percent is not UNSET:
            field_dict["scale_percent"] = scale_percent

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)

        def _parse_angle_change_deg(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        angle_change_deg = _parse_angle_change_deg(d.pop("angle_change_deg", UNSET))

        predicted_ray_error_mm = d.pop("predicted_ray_error_mm", UNSET)

        ray_change_mm = d.pop("ray_change_mm", UNSET)

        scale_percent = d.pop("scale_percent", UNSET)

        tolerances = cls(
            angle_change_deg=angle_change_deg,
            predicted_ray_error_mm=predicted_ray_error_mm,
            ray_change_mm=ray_change_mm,
            scale_percent=scale_percent,
        )

        return tolerances
