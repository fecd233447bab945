from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.data_kind import DataKind
from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.scan_shape import ScanShape
    from ..models.view_angles import ViewAngles


T = TypeVar("T", bound="InspectedReading")


@_attrs_define
class InspectedReading:
    """What would be read, no sample of it being looked at yet."""

    shape: ScanShape
    """ Of the projection stack (view, row, detector). """
    angles: None | Unset | ViewAngles = UNSET
    """ The angles that the views would have. Null: the file carries none and none were given. """
    darks: int | None | Unset = UNSET
    """ The number of dark fields; null: none. """
    data: DataKind | None | Unset = UNSET
    """ What the numbers are, as given: no file states it reliably. """
    detector_pitch_mm: float | None | Unset = UNSET
    """ Distance between neighbouring detector cells that the file states, mm. Null: it states none. """
    flats: int | None | Unset = UNSET
    """ The number of flat fields; null: none. """
    other_files: list[str] | Unset = UNSET
    """ Further files that would be read. """
    remarks: list[str] | Unset = UNSET
    """ What would be done to the data on reading. """
    row_pitch_mm: float | None | Unset = UNSET
    """ Distance between detector rows that the file states, mm. Null: it states none. """
    unused: None | str | Unset = UNSET
    """ Values that could be a pitch or a distance; no name states what they are, none is used. """

    def to_dict(self) -> dict[str, Any]:
        from ..models.view_angles import ViewAngles  # noqa: PLC0415

        shape = self.shape.to_dict()

        angles: dict[str, Any] | None | Unset
        if isinstance(self.angles, Unset):
            angles = UNSET
        elif isinstance(self.angles, ViewAngles):
            angles = self.angles.to_dict()
        else:
            angles = self.angles

        darks: int | None | Unset
        if isinstance(self.darks, Unset):
            darks = UNSET
        else:
            darks = self.darks

        data: None | str | Unset
        if isinstance(self.data, Unset):
            data = UNSET
        elif isinstance(self.data, DataKind):
            data = self.data.value
        else:
            data = self.data

        detector_pitch_mm: float | None | Unset
        if isinstance(self.detector_pitch_mm, Unset):
            detector_pitch_mm = UNSET
        else:
            detector_pitch_mm = self.detector_pitch_mm

        flats: int | None | Unset
        if isinstance(self.flats, Unset):
            flats = UNSET
        else:
            flats = self.flats

        other_files: list[str] | Unset = UNSET
        if not isinstance(self.other_files, Unset):
            other_files = self.other_files

        remarks: list[str] | Unset = UNSET
        if not isinstance(self.remarks, Unset):
            remarks = self.remarks

        row_pitch_mm: float | None | Unset
        if isinstance(self.row_pitch_mm, Unset):
            row_pitch_mm = UNSET
        else:
            row_pitch_mm = self.row_pitch_mm

        unused: None | str | Unset
        if isinstance(self.unused, Unset):
            unused = UNSET
        else:
            unused = self.unused

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "shape": shape,
            }
        )
        if angles is not UNSET:
            field_dict["angles"] = angles
        if darks is not UNSET:
            field_dict["darks"] = darks
        if data is not UNSET:
            field_dict["data"] = data
        if detector_pitch_mm is not UNSET:
            field_dict["detector_pitch_mm"] = detector_pitch_mm
        if flats is not UNSET:
            field_dict["flats"] = flats
        if other_files is not UNSET:
            field_dict["other_files"] = other_files
        if remarks is not UNSET:
            field_dict["remarks"] = remarks
        if row_pitch_mm is not UNSET:
            field_dict["row_pitch_mm"] = row_pitch_mm
        if unused is not UNSET:
            field_dict["unused"] = unused

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.scan_shape import ScanShape  # noqa: PLC0415
        from ..models.view_angles import ViewAngles  # noqa: PLC0415

        d = dict(src_dict)
        shape = ScanShape.from_dict(d.pop("shape"))

        def _parse_angles(data: object) -> None | Unset | ViewAngles:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                angles_type_0 = ViewAngles.from_dict(data)

                return angles_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(None | Unset | ViewAngles, data)

        angles = _parse_angles(d.pop("angles", UNSET))

        def _parse_darks(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        darks = _parse_darks(d.pop("darks", UNSET))

        def _parse_data(data: object) -> DataKind | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                data_type_0 = DataKind(data)

                return data_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(DataKind | None | Unset, data)

        data = _parse_data(d.pop("data", UNSET))

        def _parse_detector_pitch_mm(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        detector_pitch_mm = _parse_detector_pitch_mm(d.pop("detector_pitch_mm", UNSET))

        def _parse_flats(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        flats = _parse_flats(d.pop("flats", UNSET))

        other_files = cast(list[str], d.pop("other_files", UNSET))

        remarks = cast(list[str], d.pop("remarks", UNSET))

        def _parse_row_pitch_mm(data: object) -> float | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(float | None | Unset, data)

        row_pitch_mm = _parse_row_pitch_mm(d.pop("row_pitch_mm", UNSET))

        def _parse_unused(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        unused = _parse_unused(d.pop("unused", UNSET))

        inspected_reading = cls(
            shape=shape,
            angles=angles,
            darks=darks,
            data=data,
            detector_pitch_mm=detector_pitch_mm,
            flats=flats,
            other_files=other_files,
            remarks=remarks,
            row_pitch_mm=row_pitch_mm,
            unused=unused,
        )

        return inspected_reading
