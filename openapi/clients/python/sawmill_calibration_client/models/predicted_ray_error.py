from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..types import UNSET, Unset

T = TypeVar("T", bound="PredictedRayError")


@_attrs_define
class PredictedRayError:
    """The ray error that the covariance predicts, inside the log's disc."""

    max_: float
    """ Standard deviation at the worst point, mm. """
    radius_mm: float
    """ Of the disc in which rays are compared. In mm. """
    rms: float
    """ Root of the expected mean square over rays and points, mm. """
    upper_95: float
    """ The RMS ray error stays below this, mm, in 95 of 100 cases. """
    interval_95: list[float] | None | Unset = UNSET
    """ It lies between these, mm, in 95 of 100 cases. Null: an answer of an earlier version. """

    def to_dict(self) -> dict[str, Any]:
        max_ = self.max_

        radius_mm = self.radius_mm

        rms = self.rms

        upper_95 = self.upper_95

        interval_95: list[float] | None | Unset
        if isinstance(self.interval_95, Unset):
            interval_95 = UNSET
        elif isinstance(self.interval_95, list):
            interval_95 = []
            for interval_95_type_0_item_data in self.interval_95:
                interval_95_type_0_item: float
                interval_95_type_0_item = interval_95_type_0_item_data
                interval_95.append(interval_95_type_0_item)

        else:
            interval_95 = self.interval_95

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "max": max_,
                "radius_mm": radius_mm,
                "rms": rms,
                "upper_95": upper_95,
            }
        )
        if interval_95 is not UNSET:
            field_dict["interval_95"] = interval_95

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        max_ = d.pop("max")

        radius_mm = d.pop("radius_mm")

        rms = d.pop("rms")

        upper_95 = d.pop("upper_95")

        def _parse_interval_95(data: object) -> list[float] | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, list):
                    raise TypeError()
                interval_95_type_0 = []
                _interval_95_type_0 = data
                for interval_95_type_0_item_data in _interval_95_type_0:

                    def _parse_interval_95_type_0_item(data: object) -> float:
                        return cast(float, data)

                    interval_95_type_0_item = _parse_interval_95_type_0_item(interval_95_type_0_item_data)

                    interval_95_type_0.append(interval_95_type_0_item)

                return interval_95_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(list[float] | None | Unset, data)

        interval_95 = _parse_interval_95(d.pop("interval_95", UNSET))

        predicted_ray_error = cls(
            max_=max_,
            radius_mm=radius_mm,
            rms=rms,
            upper_95=upper_95,
            interval_95=interval_95,
        )

        return predicted_ray_error
