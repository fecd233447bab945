from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.drift_method import DriftMethod
from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.detector_deviation import DetectorDeviation
    from ..models.detector_geometry import DetectorGeometry


T = TypeVar("T", bound="DriftBaseline")


@_attrs_define
class DriftBaseline:
    """The zero of a scanner's changes, and what a drift check shows against it."""

    change: DetectorGeometry
    """ The part of the geometry that a log shows. """
    change_standard_deviation: DetectorDeviation
    """ A standard deviation of each, or how many of them; null for the distance where the scan does not show it.
    """
    cor_column_offset_mm: float
    """ u_c of the zero less the calibrated one, mm. """
    covariance: list[list[float]]
    """ Covariance of the zero, (cor_column_mm, tilt_rad), in the products of their units, without the
    calibration's. """
    first_at: datetime.datetime | None
    """ When the first of them ended. Null: on the command line, of results without a time. """
    last_at: datetime.datetime | None
    """ When the last of them ended. Null: as before. """
    looks: int
    """ Number of drift checks in it, no unit. """
    method: DriftMethod
    """ opposite-rays: every ray against the one from the other side, in dense scans all round. view-pairs: what any
    two views have in common, in scans of 8 views or more. """
    outliers: int
    """ Number of those that were left out of the mean, far from the others; no unit. """
    ray_offset_mm: float
    """ RMS distance of the rays between the zero and the calibration, mm, in the log's disc, up to a common scale:
    flat field and calibration bring it about, or a move before these logs. """
    significance: DetectorDeviation
    """ A standard deviation of each, or how many of them; null for the distance where the scan does not show it.
    """
    tilt_offset_rad: float
    """ tau of the zero less the calibrated one, radians. """
    age_hours: float | None | Unset = UNSET
    """ Number of hours from the last drift check in it to this one. Null: not known. """

    def to_dict(self) -> dict[str, Any]:
        change = self.change.to_dict()

        change_standard_deviation = self.change_standard_deviation.to_dict()

        cor_column_offset_mm = self.cor_column_offset_mm

        covariance = []
        for covariance_item_data in self.covariance:
            covariance_item = covariance_item_data

            covariance.append(covariance_item)

        first_at: None | str
        if isinstance(self.first_at, datetime.datetime):
            first_at = self.first_at.isoformat()
        else:
            first_at = self.first_at

        last_at: None | str
        if isinstance(self.last_at, datetime.datetime):
            last_at = self.last_at.isoformat()
        else:
            last_at = self.last_at

        looks = self.looks

        method = self.method.value

        outliers = self.outliers

        ray_offset_mm = self.ray_offset_mm

        significance = self.significance.to_dict()

        tilt_offset_rad = self.tilt_offset_rad

        age_hours: float | None | Unset
        if isinstance(self.age_hours, Unset):
            age_hours = UNSET
        else:
            age_hours = self.age_hours

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "change": change,
                "change_standard_deviation": change_standard_deviation,
                "cor_column_offset_mm": cor_column_offset_mm,
                "covariance": covariance,
                "first_at": first_at,
                "last_at": last_at,
                "looks": looks,
                "method": method,
                "outliers": outliers,
                "ray_offset_mm": ray_offset_mm,
                "significance": significance,
                "tilt_offset_rad": tilt_offset_rad,
            }
        )
        if age_hours is not UNSET:
            field_dict["age_hours"] = age_hours

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.detector_deviation import DetectorDeviation  # noqa: PLC0415
        from ..models.detector_geometry import DetectorGeometry  # noqa: PLC0415

        d = dict(src_dict)
        change = DetectorGeometry.from_dict(d.pop("change"))

        change_standard_deviation = DetectorDeviation.from_dict(d.pop("change_standard_deviation"))

        cor_column_offset_mm = d.pop("cor_column_offset_mm")

        covariance = []
        _covariance = d.pop("covariance")
        for covariance_item_data in _covariance:
            covariance_item = cast(list[float], covariance_item_data)

            covariance.append(covariance_item)

        def _parse_first_at(data: object) -> datetime.datetime | None:
            if data is None:
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                first_at_type_0 = datetime.datetime.fromisoformat(data)

                return first_at_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(datetime.datetime | None, data)

        first_at = _parse_first_at(d.pop("first_at"))

        def _parse_last_at(data: object) -> datetime.datetime | None:
            if data is None:
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                last_at_type_0 = datetime.datetime.fromisoformat(data)

                return last_at_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(datetime.datetime | None, data)

        last_at = _parse_last_at(d.pop("last_at"))

        looks = d.pop("looks")

        method = DriftMethod(d.pop("method"))

        outliers = d.pop("outliers")

        ray_offset_mm = d.pop("ray_offset_mm")

        significance = DetectorDeviation.from_dict(d.pop("significance"))

        tilt_offset_rad = d.pop("tilt_offset_rad")

        def _parse_age_hours(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        age_hours = _parse_age_hours(d.pop("age_hours", UNSET))

        drift_baseline = cls(
            change=change,
            change_standard_deviation=change_standard_deviation,
            cor_column_offset_mm=cor_column_offset_mm,
            covariance=covariance,
            first_at=first_at,
            last_at=last_at,
            looks=looks,
            method=method,
            outliers=outliers,
            ray_offset_mm=ray_offset_mm,
            significance=significance,
            tilt_offset_rad=tilt_offset_rad,
            age_hours=age_hours,
        )

        return drift_baseline
