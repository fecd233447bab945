from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.axis import Axis
from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.disc import Disc
    from ..models.polygon import Polygon
    from ..models.size_measurement import SizeMeasurement


T = TypeVar("T", bound="PhantomAsk")


@_attrs_define
class PhantomAsk:
    """A phantom as somebody draws it, every shape with an inside. Also the JSON file of `--phantom FILE.json`."""

    name: str
    """ What people call it. """
    shapes: list[Disc | Polygon]
    """ Polygons and discs, mm; a later one adds its density to what lies beneath. """
    follows: None | Unset = UNSET
    """ To be left out: measuring a stored phantom anew sets it. """
    measurements: list[SizeMeasurement] | Unset = UNSET
    """ Where its size comes from; the shapes are drawn as measured. """
    size_tolerance: float | Unset = UNSET
    """ Relative standard uncertainty of the stated size, no unit; the scanner's scale inherits it. By default the
    RMS of the measurements' relative uncertainties, 0.0015 without any. """
    true_axis: Axis | None | Unset = UNSET
    """ Axis along which the size is right, where the phantom may differ along the other. """

    def to_dict(self) -> dict[str, Any]:
        from ..models.polygon import Polygon  # noqa: PLC0415

        name = self.name

        shapes = []
        for shapes_item_data in self.shapes:
            shapes_item: dict[str, Any]
            if isinstance(shapes_item_data, Polygon):
                shapes_item = shapes_item_data.to_dict()
            else:
                shapes_item = shapes_item_data.to_dict()

            shapes.append(shapes_item)

        follows = self.follows

        measurements: list[dict[str, Any]] | Unset = UNSET
        if not isinstance(self.measurements, Unset):
            measurements = []
            for measurements_item_data in self.measurements:
                measurements_item = measurements_item_data.to_dict()
                measurements.append(measurements_item)

        size_tolerance = self.size_tolerance

        true_axis: None | str | Unset
        if isinstance(self.true_axis, Unset):
            true_axis = UNSET
        elif isinstance(self.true_axis, Axis):
            true_axis = self.true_axis.value
        else:
            true_axis = self.true_axis

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "name": name,
                "shapes": shapes,
            }
        )
        if follows is not UNSET:
            field_dict["follows"] = follows
        if measurements is not UNSET:
            field_dict["measurements"] = measurements
        if size_tolerance is not UNSET:
            field_dict["size_tolerance"] = size_tolerance
        if true_axis is not UNSET:
            field_dict["true_axis"] = true_axis

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.disc import Disc  # noqa: PLC0415
        from ..models.polygon import Polygon  # noqa: PLC0415
        from ..models.size_measurement import SizeMeasurement  # noqa: PLC0415

        d = dict(src_dict)
        name = d.pop("name")

        shapes = []
        _shapes = d.pop("shapes")
        for shapes_item_data in _shapes:

            def _parse_shapes_item(data: object) -> Disc | Polygon:
                try:
                    if not isinstance(data, dict):
                        raise TypeError()
                    shapes_item_type_0 = Polygon.from_dict(data)

                    return shapes_item_type_0
                except (TypeError, ValueError, AttributeError, KeyError):
                    pass
                if not isinstance(data, dict):
                    raise TypeError()
                shapes_item_type_1 = Disc.from_dict(data)

                return shapes_item_type_1

            shapes_item = _parse_shapes_item(shapes_item_data)

            shapes.append(shapes_item)

        follows = d.pop("follows", UNSET)

        _measurements = d.pop("measurements", UNSET)
        measurements: list[SizeMeasurement] | Unset = UNSET
        if _measurements is not UNSET:
            measurements = []
            for measurements_item_data in _measurements:
                measurements_item = SizeMeasurement.from_dict(measurements_item_data)

                measurements.append(measurements_item)

        size_tolerance = d.pop("size_tolerance", UNSET)

        def _parse_true_axis(data: object) -> Axis | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                true_axis_type_0 = Axis(data)

                return true_axis_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(Axis | None | Unset, data)

        true_axis = _parse_true_axis(d.pop("true_axis", UNSET))

        phantom_ask = cls(
            name=name,
            shapes=shapes,
            follows=follows,
            measurements=measurements,
            size_tolerance=size_tolerance,
            true_axis=true_axis,
        )

        return phantom_ask
