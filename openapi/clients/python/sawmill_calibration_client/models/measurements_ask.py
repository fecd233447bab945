from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

from attrs import define as _attrs_define

from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.size_measurement import SizeMeasurement


T = TypeVar("T", bound="MeasurementsAsk")


@_attrs_define
class MeasurementsAsk:
    """A stored phantom's sides, measured anew."""

    measurements: list[SizeMeasurement]
    """ The lengths that were measured. """
    stretch_drawing: bool | Unset = True
    """ Stretch the shapes along x and y to what was measured there. """

    def to_dict(self) -> dict[str, Any]:
        measurements = []
        for measurements_item_data in self.measurements:
            measurements_item = measurements_item_data.to_dict()
            measurements.append(measurements_item)

        stretch_drawing = self.stretch_drawing

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "measurements": measurements,
            }
        )
        if stretch_drawing is not UNSET:
            field_dict["stretch_drawing"] = stretch_drawing

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.size_measurement import SizeMeasurement  # noqa: PLC0415

        d = dict(src_dict)
        measurements = []
        _measurements = d.pop("measurements")
        for measurements_item_data in _measurements:
            measurements_item = SizeMeasurement.from_dict(measurements_item_data)

            measurements.append(measurements_item)

        stretch_drawing = d.pop("stretch_drawing", UNSET)

        measurements_ask = cls(
            measurements=measurements,
            stretch_drawing=stretch_drawing,
        )

        return measurements_ask
