from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..types import UNSET, Unset

T = TypeVar("T", bound="Comparison")


@_attrs_define
class Comparison:
    """Against the scanner's active calibration."""

    angle_change_deg: float
    """ Change of the first angle. In degrees. """
    calibration_id: str
    """ Id of the calibration that was active. """
    cor_column_change_mm: float
    """ Change of u_c, where the centre of rotation falls on the detector, mm. """
    ray_change_mm: float
    """ RMS distance between the two calibrations' rays inside the log's disc, one common rotation and one common
    scale taken out. """
    reason: str
    """ What the changes mean, in one sentence. """
    source_distance_change_mm: float
    """ Change of R, the distance from the source to the centre of rotation, mm. """
    tilt_change_deg: float
    """ Change of tau, the detector's tilt, degrees. """
    within_tolerance: bool
    """ Whether nothing moved beyond the scanner's tolerances. """
    scale_change_percent: float | None | Unset = UNSET
    """ Change of that common scale. Null: an answer of an earlier version, which did not report it. In per cent.
    """
    scale_change_uncertainty_percent: float | None | Unset = UNSET
    """ Of the change of scale, 95 %, from both covariances; null without error bars. """
    tolerance_mm: float | None | Unset = UNSET
    """ What `ray_change_mm` may be. Null: an answer of an earlier version. """

    def to_dict(self) -> dict[str, Any]:
        angle_change_deg = self.angle_change_deg

        calibration_id = self.calibration_id

        cor_column_change_mm = self.cor_column_change_mm

        ray_change_mm = self.ray_change_mm

        reason = self.reason

        source_distance_change_mm = self.source_distance_change_mm

        tilt_change_deg = self.tilt_change_deg

        within_tolerance = self.within_tolerance

        scale_change_percent: float | None | Unset
        if isinstance(self.scale_change_percent, Unset):
            scale_change_percent = UNSET
        else:
            scale_change_percent = self.scale_change_percent

        scale_change_uncertainty_percent: float | None | Unset
        if isinstance(self.scale_change_uncertainty_percent, Unset):
            scale_change_uncertainty_percent = UNSET
        else:
            scale_change_uncertainty_percent = self.scale_change_uncertainty_percent

        tolerance_mm: float | None | Unset
        if isinstance(self.tolerance_mm, Unset):
            tolerance_mm = UNSET
        else:
            tolerance_mm = self.tolerance_mm

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "angle_change_deg": angle_change_deg,
                "calibration_id": calibration_id,
                "cor_column_change_mm": cor_column_change_mm,
                "ray_change_mm": ray_change_mm,
                "reason": reason,
                "source_distance_change_mm": source_distance_change_mm,
                "tilt_change_deg": tilt_change_deg,
                "within_tolerance": within_tolerance,
            }
        )
        if scale_change_percent is not UNSET:
            field_dict["scale_change_percent"] = scale_change_percent
        if scale_change_uncertainty_percent is not UNSET:
            field_dict["scale_change_uncertainty_percent"] = scale_change_uncertainty_percent
        if tolerance_mm is not UNSET:
            field_dict["tolerance_mm"] = tolerance_mm

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        angle_change_deg = d.pop("angle_change_deg")

        calibration_id = d.pop("calibration_id")

        cor_column_change_mm = d.pop("cor_column_change_mm")

        ray_change_mm = d.pop("ray_change_mm")

        reason = d.pop("reason")

        source_distance_change_mm = d.pop("source_distance_change_mm")

        tilt_change_deg = d.pop("tilt_change_deg")

        within_tolerance = d.pop("within_tolerance")

        def _parse_scale_change_percent(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        scale_change_percent = _parse_scale_change_percent(d.pop("scale_change_percent", UNSET))

        def _parse_scale_change_uncertainty_percent(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        scale_change_uncertainty_percent = _parse_scale_change_uncertainty_percent(
            d.pop("scale_change_uncertainty_percent", UNSET)
        )

        def _parse_tolerance_mm(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        tolerance_mm = _parse_tolerance_mm(d.pop("tolerance_mm", UNSET))

        comparison = cls(
            angle_change_deg=angle_change_deg,
            calibration_id=calibration_id,
            cor_column_change_mm=cor_column_change_mm,
            ray_change_mm=ray_change_mm,
            reason=reason,
            source_distance_change_mm=source_distance_change_mm,
            tilt_change_deg=tilt_change_deg,
            within_tolerance=within_tolerance,
            scale_change_percent=scale_change_percent,
            scale_change_uncertainty_percent=scale_change_uncertainty_percent,
            tolerance_mm=tolerance_mm,
        )

        return comparison
