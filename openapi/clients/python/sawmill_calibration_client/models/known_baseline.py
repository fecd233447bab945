from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.drift_method import DriftMethod

T = TypeVar("T", bound="KnownBaseline")


@_attrs_define
class KnownBaseline:
    """What the first drift checks by one method after a calibration measured together: the zero of later ones."""

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
    tilt_offset_rad: float
    """ tau of the zero less the calibrated one, radians. """

    def to_dict(self) -> dict[str, Any]:
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

        tilt_offset_rad = self.tilt_offset_rad

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "cor_column_offset_mm": cor_column_offset_mm,
                "covariance": covariance,
                "first_at": first_at,
                "last_at": last_at,
                "looks": looks,
                "method": method,
                "outliers": outliers,
                "tilt_offset_rad": tilt_offset_rad,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
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

        tilt_offset_rad = d.pop("tilt_offset_rad")

        known_baseline = cls(
            cor_column_offset_mm=cor_column_offset_mm,
            covariance=covariance,
            first_at=first_at,
            last_at=last_at,
            looks=looks,
            method=method,
            outliers=outliers,
            tilt_offset_rad=tilt_offset_rad,
        )

        return known_baseline
