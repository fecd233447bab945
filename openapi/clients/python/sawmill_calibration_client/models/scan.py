from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.air_correction import AirCorrection
from ..models.data_kind import DataKind
from ..models.faulty_cells import FaultyCells
from ..models.ring_removal import RingRemoval
from ..models.row_alignment import RowAlignment
from ..models.scan_state import ScanState
from ..types import UNSET, Unset

if TYPE_CHECKING:
    from ..models.scan_shape import ScanShape


T = TypeVar("T", bound="Scan")


@_attrs_define
class Scan:
    """A scan as it stands."""

    created_at: datetime.datetime
    """ When it was created, RFC 3339, UTC. """
    data: DataKind
    """ What the numbers of a scan are. Never guessed. """
    id: str
    """ The resource's id, which the service gives. """
    job_id: str
    """ Id of the job that reads it. """
    scanner_id: str
    """ Id of the scanner that made it. """
    sha256: str
    """ SHA-256 of the file, in hexadecimal digits. """
    size_bytes: int
    """ Size of the file, bytes. """
    state: ScanState
    """ An upload is read by a job before it can be used. """
    air: AirCorrection | Unset = UNSET
    """ What the air at the detector's ends takes out of the line integrals.

    `background` is one constant for a row. `views` is each view's level where it drifts, else the constant. `auto`
    is
    `views` for counts and `off` for line integrals. """
    align_rows: RowAlignment | Unset = UNSET
    """ How views that lost rows are aligned along the log. """
    angles_deg: None | str | Unset = UNSET
    """ START:STEP in degrees, or every view's angle separated by commas; where the file carries none. """
    angular_range_deg: list[float] | None | Unset = UNSET
    """ First and last view's angle, degrees. Null: it has not been read. """
    averaged_rows: int | None | Unset = UNSET
    """ The file is (views, detector): each line integral is the mean over this number of detector rows. NaN masks a
    ray; an array `deviations` beside them, in NPZ, MAT or HDF5, has their standard deviations. Null: rows as they
    were measured. """
    dataset: None | str | Unset = UNSET
    """ Path or variable of the projections, where the file holds several. Null: not given. """
    faulty_cells: FaultyCells | Unset = UNSET
    """ What becomes of dead and hot detector cells. """
    format_: None | str | Unset = UNSET
    """ What the file turned out to be. Null: it has not been read. """
    name: str | Unset = "scan"
    """ What people call it. """
    phantom_id: None | str | Unset = UNSET
    """ The phantom in this scan; null for a scan without one. """
    phantom_rows: None | str | Unset = UNSET
    """ The rows that show the phantom; null: they are found. """
    reason: None | str | Unset = UNSET
    """ Why the file was refused, in one sentence. Null: it was not. """
    remarks: list[str] | Unset = UNSET
    """ What was done to the data on reading. """
    rings: RingRemoval | Unset = UNSET
    """ How rings are taken out. """
    shape: None | ScanShape | Unset = UNSET
    """ Size of the projection stack. Null: it has not been read. """
    usable_rows: list[int] | None | Unset = UNSET
    """ The rows that enough views have, the first and the one after the last, where views lost some; null: all
    rows. """

    def to_dict(self) -> dict[str, Any]:
        from ..models.scan_shape import ScanShape  # noqa: PLC0415

        created_at = self.created_at.isoformat()

        data = self.data.value

        id = self.id

        job_id = self.job_id

        scanner_id = self.scanner_id

        sha256 = self.sha256

        size_bytes = self.size_bytes

        state = self.state.value

        air: str | Unset = UNSET
        if not isinstance(self.air, Unset):
            air = self.air.value

        align_rows: str | Unset = UNSET
        if not isinstance(self.align_rows, Unset):
            align_rows = self.align_rows.value

        angles_deg: None | str | Unset
        if isinstance(self.angles_deg, Unset):
            angles_deg = UNSET
        else:
            angles_deg = self.angles_deg

        angular_range_deg: list[float] | None | Unset
        if isinstance(self.angular_range_deg, Unset):
            angular_range_deg = UNSET
        elif isinstance(self.angular_range_deg, list):
            angular_range_deg = []
            for angular_range_deg_type_0_item_data in self.angular_range_deg:
                angular_range_deg_type_0_item: float
                angular_range_deg_type_0_item = angular_range_deg_type_0_item_data
                angular_range_deg.append(angular_range_deg_type_0_item)

        else:
            angular_range_deg = self.angular_range_deg

        averaged_rows: int | None | Unset
        if isinstance(self.averaged_rows, Unset):
            averaged_rows = UNSET
        else:
            averaged_rows = self.averaged_rows

        dataset: None | str | Unset
        if isinstance(self.dataset, Unset):
            dataset = UNSET
        else:
            dataset = self.dataset

        faulty_cells: str | Unset = UNSET
        if not isinstance(self.faulty_cells, Unset):
            faulty_cells = self.faulty_cells.value

        format_: None | str | Unset
        if isinstance(self.format_, Unset):
            format_ = UNSET
        else:
            format_ = self.format_

        name = self.name

        phantom_id: None | str | Unset
        if isinstance(self.phantom_id, Unset):
            phantom_id = UNSET
        else:
            phantom_id = self.phantom_id

        phantom_rows: None | str | Unset
        if isinstance(self.phantom_rows, Unset):
            phantom_rows = UNSET
        else:
            phantom_rows = self.phantom_rows

        reason: None | str | Unset
        if isinstance(self.reason, Unset):
            reason = UNSET
        else:
            reason = self.reason

        remarks: list[str] | Unset = UNSET
        if not isinstance(self.remarks, Unset):
            remarks = self.remarks

        rings: str | Unset = UNSET
        if not isinstance(self.rings, Unset):
            rings = self.rings.value

        shape: dict[str, Any] | None | Unset
        if isinstance(self.shape, Unset):
            shape = UNSET
        elif isinstance(self.shape, ScanShape):
            shape = self.shape.to_dict()
        else:
            shape = self.shape

        usable_rows: list[int] | None | Unset
        if isinstance(self.usable_rows, Unset):
            usable_rows = UNSET
        elif isinstance(self.usable_rows, list):
            usable_rows = []
            for usable_rows_type_0_item_data in self.usable_rows:
                usable_rows_type_0_item: int
                usable_rows_type_0_item = usable_rows_type_0_item_data
                usable_rows.append(usable_rows_type_0_item)

        else:
            usable_rows = self.usable_rows

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "created_at": created_at,
                "data": data,
                "id": id,
                "job_id": job_id,
                "scanner_id": scanner_id,
                "sha256": sha256,
                "size_bytes": size_bytes,
                "state": state,
            }
        )
        if air is not UNSET:
            field_dict["air"] = air
        if align_rows is not UNSET:
            field_dict["align_rows"] = align_rows
        if angles_deg is not UNSET:
            field_dict["angles_deg"] = angles_deg
        if angular_range_deg is not UNSET:
            field_dict["angular_range_deg"] = angular_range_deg
        if averaged_rows is not UNSET:
            field_dict["averaged_rows"] = averaged_rows
        if dataset is not UNSET:
            field_dict["dataset"] = dataset
        if faulty_cells is not UNSET:
            field_dict["faulty_cells"] = faulty_cells
        if format_ is not UNSET:
            field_dict["format"] = format_
        if name is not UNSET:
            field_dict["name"] = name
        if phantom_id is not UNSET:
            field_dict["phantom_id"] = phantom_id
        if phantom_rows is not UNSET:
            field_dict["phantom_rows"] = phantom_rows
        if reason is not UNSET:
            field_dict["reason"] = reason
        if remarks is not UNSET:
            field_dict["remarks"] = remarks
        if rings is not UNSET:
            field_dict["rings"] = rings
        if shape is not UNSET:
            field_dict["shape"] = shape
        if usable_rows is not UNSET:
            field_dict["usable_rows"] = usable_rows

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.scan_shape import ScanShape  # noqa: PLC0415

        d = dict(src_dict)
        created_at = datetime.datetime.fromisoformat(d.pop("created_at"))

        data = DataKind(d.pop("data"))

        id = d.pop("id")

        job_id = d.pop("job_id")

        scanner_id = d.pop("scanner_id")

        sha256 = d.pop("sha256")

        size_bytes = d.pop("size_bytes")

        state = ScanState(d.pop("state"))

        _air = d.pop("air", UNSET)
        air: AirCorrection | Unset
        if isinstance(_air, Unset):
            air = UNSET
        else:
            air = AirCorrection(_air)

        _align_rows = d.pop("align_rows", UNSET)
        align_rows: RowAlignment | Unset
        if isinstance(_align_rows, Unset):
            align_rows = UNSET
        else:
            align_rows = RowAlignment(_align_rows)

        def _parse_angles_deg(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        angles_deg = _parse_angles_deg(d.pop("angles_deg", UNSET))

        def _parse_angular_range_deg(data: object) -> list[float] | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, list):
                    raise TypeError()
                angular_range_deg_type_0 = []
                _angular_range_deg_type_0 = data
                for angular_range_deg_type_0_item_data in _angular_range_deg_type_0:

                    def _parse_angular_range_deg_type_0_item(data: object) -> float:
                        return cast(float, data)

                    angular_range_deg_type_0_item = _parse_angular_range_deg_type_0_item(
                        angular_range_deg_type_0_item_data
                    )

                    angular_range_deg_type_0.append(angular_range_deg_type_0_item)

                return angular_range_deg_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(list[float] | None | Unset, data)

        angular_range_deg = _parse_angular_range_deg(d.pop("angular_range_deg", UNSET))

        def _parse_averaged_rows(data: object) -> int | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(int | None | Unset, data)

        averaged_rows = _parse_averaged_rows(d.pop("averaged_rows", UNSET))

        def _parse_dataset(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        dataset = _parse_dataset(d.pop("dataset", UNSET))

        _faulty_cells = d.pop("faulty_cells", UNSET)
        faulty_cells: FaultyCells | Unset
        if isinstance(_faulty_cells, Unset):
            faulty_cells = UNSET
        else:
            faulty_cells = FaultyCells(_faulty_cells)

        def _parse_format_(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        format_ = _parse_format_(d.pop("format", UNSET))

        name = d.pop("name", UNSET)

        def _parse_phantom_id(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        phantom_id = _parse_phantom_id(d.pop("phantom_id", UNSET))

        def _parse_phantom_rows(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        phantom_rows = _parse_phantom_rows(d.pop("phantom_rows", UNSET))

        def _parse_reason(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        reason = _parse_reason(d.pop("reason", UNSET))

        remarks = cast(list[str], d.pop("remarks", UNSET))

        _rings = d.pop("rings", UNSET)
        rings: RingRemoval | Unset
        if isinstance(_rings, Unset):
            rings = UNSET
        else:
            rings = RingRemoval(_rings)

        def _parse_shape(data: object) -> None | ScanShape | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                shape_type_0 = ScanShape.from_dict(data)

                return shape_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(None | ScanShape | Unset, data)

        shape = _parse_shape(d.pop("shape", UNSET))

        def _parse_usable_rows(data: object) -> list[int] | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, list):
                    raise TypeError()
                usable_rows_type_0 = []
                _usable_rows_type_0 = data
                for usable_rows_type_0_item_data in _usable_rows_type_0:

                    def _parse_usable_rows_type_0_item(data: object) -> int:
                        return cast(int, data)

                    usable_rows_type_0_item = _parse_usable_rows_type_0_item(usable_rows_type_0_item_data)

                    usable_rows_type_0.append(usable_rows_type_0_item)

                return usable_rows_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(list[int] | None | Unset, data)

        usable_rows = _parse_usable_rows(d.pop("usable_rows", UNSET))

        scan = cls(
            created_at=created_at,
            data=data,
            id=id,
            job_id=job_id,
            scanner_id=scanner_id,
            sha256=sha256,
            size_bytes=size_bytes,
            state=state,
            air=air,
            align_rows=align_rows,
            angles_deg=angles_deg,
            angular_range_deg=angular_range_deg,
            averaged_rows=averaged_rows,
            dataset=dataset,
            faulty_cells=faulty_cells,
            format_=format_,
            name=name,
            phantom_id=phantom_id,
            phantom_rows=phantom_rows,
            reason=reason,
            remarks=remarks,
            rings=rings,
            shape=shape,
            usable_rows=usable_rows,
        )

        return scan
