from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.handedness import Handedness
from ..models.rotation import Rotation
from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.method_report import MethodReport
    from ..models.theta import Theta


T = TypeVar("T", bound="ReconstructionResult")


@_attrs_define
class ReconstructionResult:
    """The result beside the volume."""

    handedness: Handedness
    """ From which end the phantom was looked at: as drawn, or from behind (y becomes -y). """
    input_sha256: str
    """ SHA-256 of the scan's file, in hexadecimal digits. """
    pixel_mm: float
    """ Side of a pixel, mm. """
    rotation: Rotation
    """ Which way the view angles count: as the scan gives them, or the other way (phi becomes -phi). """
    rows: list[int]
    """ Detector rows that were reconstructed: the first one and the one after the last. """
    shape: list[int]
    """ Number of values along (slice, x, y). """
    software_version: str
    """ Version of the software that computed it. """
    theta: Theta
    """ The five numbers that cannot be measured by hand: theta = (alpha0, r_D, h_S, h_D, alpha_D). """
    time_s: float
    """ Seconds that the computation took. """
    unit: str
    """ Unit of the volume's values. """
    value_range: list[float]
    """ 0.1 and 99.9 percentile over the volume, in its unit. """
    views: int
    """ Number of views of the scan. """
    fewest_views: int | None | Unset = UNSET
    """ Number of views of the slice that fewest views show, where views lost rows. Null: none did. """
    has_deviation: bool | Unset = False
    """ Of an earlier version's result: each pixel's standard deviation is in the volume. """
    method: MethodReport | None | Unset = UNSET
    """ Null for a result of an earlier version, whose method was fbp. """
    preparation: list[str] | Unset = UNSET
    """ The steps that prepared the scan's data. """
    row_step: int | Unset = 1
    """ Every row_step-th of the rows is a slice. """

    def to_dict(self) -> dict[str, Any]:
        from ..models.method_report import MethodReport  # noqa: PLC0415

        handedness = self.handedness.value

        input_sha256 = self.input_sha256

        pixel_mm = self.pixel_mm

        rotation = self.rotation.value

        rows = []
        for rows_item_data in self.rows:
            rows_item: int
            rows_item = rows_item_data
            rows.append(rows_item)

        shape = []
        for shape_item_data in self.shape:
            shape_item: int
            shape_item = shape_item_data
            shape.append(shape_item)

        software_version = self.software_version

        theta = self.theta.to_dict()

        time_s = self.time_s

        unit = self.unit

        value_range = []
        for value_range_item_data in self.value_range:
            value_range_item: float
            value_range_item = value_range_item_data
            value_range.append(value_range_item)

        views = self.views

        fewest_views: int | None | Unset
        if isinstance(self.fewest_views, Unset):
            fewest_views = UNSET
        else:
            fewest_views = self.fewest_views

        has_deviation = self.has_deviation

        method: dict[str, Any] | None | Unset
        if isinstance(self.method, Unset):
            method = UNSET
        elif isinstance(self.method, MethodReport):
            method = self.method.to_dict()
        else:
            method = self.method

        preparation: list[str] | Unset = UNSET
        if not isinstance(self.preparation, Unset):
            preparation = self.preparation

        row_step = self.row_step

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "handedness": handedness,
                "input_sha256": input_sha256,
                "pixel_mm": pixel_mm,
                "rotation": rotation,
                "rows": rows,
                "shape": shape,
                "software_version": software_version,
                "theta": theta,
                "time_s": time_s,
                "unit": unit,
                "value_range": value_range,
                "views": views,
            }
        )
        if fewest_views is not UNSET:
            field_dict["fewest_views"] = fewest_views
        if has_deviation is not UNSET:
            field_dict["has_deviation"] = has_deviation
        if method is not UNSET:
            field_dict["method"] = method
        if preparation is not UNSET:
            field_dict["preparation"] = preparation
        if row_step is not UNSET:
            field_dict["row_step"] = row_step

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.method_report import MethodReport  # noqa: PLC0415
        from ..models.theta import Theta  # noqa: PLC0415

        d = dict(src_dict)
        handedness = Handedness(d.pop("handedness"))

        input_sha256 = d.pop("input_sha256")

        pixel_mm = d.pop("pixel_mm")

        rotation = Rotation(d.pop("rotation"))

        rows = []
        _rows = d.pop("rows")
        for rows_item_data in _rows:

            def _parse_rows_item(data: object) -> int:
                return cast(int, data)

            rows_item = _parse_rows_item(rows_item_data)

            rows.append(rows_item)

        shape = []
        _shape = d.pop("shape")
        for shape_item_data in _shape:

            def _parse_shape_item(data: object) -> int:
                return cast(int, data)

            shape_item = _parse_shape_item(shape_item_data)

            shape.append(shape_item)

        software_version = d.pop("software_version")

        theta = Theta.from_dict(d.pop("theta"))

        time_s = d.pop("time_s")

        unit = d.pop("unit")

        value_range = []
        _value_range = d.pop("value_range")
        for value_range_item_data in _value_range:

            def _parse_value_range_item(data: object) -> float:
                return cast(float, data)

            value_range_item = _parse_value_range_item(value_range_item_data)

            value_range.append(value_range_item)

        views = d.pop("views")

        def _parse_fewest_views(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        fewest_views = _parse_fewest_views(d.pop("fewest_views", UNSET))

        has_deviation = d.pop("has_deviation", UNSET)

        def _parse_method(data: object) -> MethodReport | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                method_type_0 = MethodReport.from_dict(data)

                return method_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(MethodReport | None | Unset, data)

        method = _parse_method(d.pop("method", UNSET))

        preparation = cast(list[str], d.pop("preparation", UNSET))

        row_step = d.pop("row_step", UNSET)

        reconstruction_result = cls(
            handedness=handedness,
            input_sha256=input_sha256,
            pixel_mm=pixel_mm,
            rotation=rotation,
            rows=rows,
            shape=shape,
            software_version=software_version,
            theta=theta,
            time_s=time_s,
            unit=unit,
            value_range=value_range,
            views=views,
            fewest_views=fewest_views,
            has_deviation=has_deviation,
            method=method,
            preparation=preparation,
            row_step=row_step,
        )

        return reconstruction_result
