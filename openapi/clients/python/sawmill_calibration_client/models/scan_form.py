from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from typing import Any, TypeVar

from attrs import define as _attrs_define

from .. import types
from ..models.air_correction import AirCorrection
from ..models.data_kind import DataKind
from ..models.faulty_cells import FaultyCells
from ..models.priority import Priority
from ..models.ring_removal import RingRemoval
from ..models.row_alignment import RowAlignment
from ..types import UNSET, File, Unset

T = TypeVar("T", bound="ScanForm")


@_attrs_define
class ScanForm:
    """A scan's file, what is given with it, and how urgent its reading is."""

    data: DataKind
    """ What the numbers of a scan are. Never guessed. """
    file: File
    """ The file's bytes; `filename` beside them is its name. """
    scanner_id: str
    """ Id of the scanner that made it. """
    air: AirCorrection | Unset = UNSET
    """ What the air at the detector's ends takes out of the line integrals.

    `background` is one constant for a row. `views` is each view's level where it drifts, else the constant. `auto`
    is
    `views` for counts and `off` for line integrals. """
    align_rows: RowAlignment | Unset = UNSET
    """ How views that lost rows are aligned along the log. """
    angles_deg: str | Unset = UNSET
    """ START:STEP in degrees, or every view's angle separated by commas; where the file carries none. """
    averaged_rows: int | Unset = UNSET
    """ The file is (views, detector): each line integral is the mean over this number of detector rows. NaN masks a
    ray; an array `deviations` beside them, in NPZ, MAT or HDF5, has their standard deviations. Null: rows as they
    were measured. """
    dataset: str | Unset = UNSET
    """ Path or variable of the projections, where the file holds several. Null: not given. """
    faulty_cells: FaultyCells | Unset = UNSET
    """ What becomes of dead and hot detector cells. """
    name: str | Unset = UNSET
    """ What people call it; left out: the file's name. """
    phantom_id: str | Unset = UNSET
    """ The phantom in this scan; null for a scan without one. """
    phantom_rows: str | Unset = UNSET
    """ The rows that show the phantom; null: they are found. """
    priority: Priority | Unset = UNSET
    """ Which job comes first: somebody waits for it, it is one of many as of a schedule, or it is for idle times.
    """
    rings: RingRemoval | Unset = UNSET
    """ How rings are taken out. """

    def to_dict(self) -> dict[str, Any]:
        data = self.data.value

        file = self.file.to_tuple()

        scanner_id = self.scanner_id

        air: str | Unset = UNSET
        if not isinstance(self.air, Unset):
            air = self.air.value

        align_rows: str | Unset = UNSET
        if not isinstance(self.align_rows, Unset):
            align_rows = self.align_rows.value

        angles_deg = self.angles_deg

        averaged_rows = self.averaged_rows

        dataset = self.dataset

        faulty_cells: str | Unset = UNSET
        if not isinstance(self.faulty_cells, Unset):
            faulty_cells = self.faulty_cells.value

        name = self.name

        phantom_id = self.phantom_id

        phantom_rows = self.phantom_rows

        priority: str | Unset = UNSET
        if not isinstance(self.priority, Unset):
            priority = self.priority.value

        rings: str | Unset = UNSET
        if not isinstance(self.rings, Unset):
            rings = self.rings.value

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "data": data,
                "file": file,
                "scanner_id": scanner_id,
            }
        )
        if air is not UNSET:
            field_dict["air"] = air
        if align_rows is not UNSET:
            field_dict["align_rows"] = align_rows
        if angles_deg is not UNSET:
            field_dict["angles_deg"] = angles_deg
        if averaged_rows is not UNSET:
            field_dict["averaged_rows"] = averaged_rows
        if dataset is not UNSET:
            field_dict["dataset"] = dataset
        if faulty_cells is not UNSET:
            field_dict["faulty_cells"] = faulty_cells
        if name is not UNSET:
            field_dict["name"] = name
        if phantom_id is not UNSET:
            field_dict["phantom_id"] = phantom_id
        if phantom_rows is not UNSET:
            field_dict["phantom_rows"] = phantom_rows
        if priority is not UNSET:
            field_dict["priority"] = priority
        if rings is not UNSET:
            field_dict["rings"] = rings

        return field_dict

    def to_multipart(self) -> types.RequestFiles:
        files: types.RequestFiles = []

        files.append(("data", (None, str(self.data.value).encode(), "text/plain")))

        files.append(("file", self.file.to_tuple()))

        files.append(("scanner_id", (None, str(self.scanner_id).encode(), "text/plain")))

        if not isinstance(self.air, Unset):
            files.append(("air", (None, str(self.air.value).encode(), "text/plain")))

        if not isinstance(self.align_rows, Unset):
            files.append(("align_rows", (None, str(self.align_rows.value).encode(), "text/plain")))

        if not isinstance(self.angles_deg, Unset):
            files.append(("angles_deg", (None, str(self.angles_deg).encode(), "text/plain")))

        if not isinstance(self.averaged_rows, Unset):
            files.append(("averaged_rows", (None, str(self.averaged_rows).encode(), "text/plain")))

        if not isinstance(self.dataset, Unset):
            files.append(("dataset", (None, str(self.dataset).encode(), "text/plain")))

        if not isinstance(self.faulty_cells, Unset):
            files.append(("faulty_cells", (None, str(self.faulty_cells.value).encode(), "text/plain")))

        if not isinstance(self.name, Unset):
            files.append(("name", (None, str(self.name).encode(), "text/plain")))

        if not isinstance(self.phantom_id, Unset):
            files.append(("phantom_id", (None, str(self.phantom_id).encode(), "text/plain")))

        if not isinstance(self.phantom_rows, Unset):
            files.append(("phantom_rows", (None, str(self.phantom_rows).encode(), "text/plain")))

        if not isinstance(self.priority, Unset):
            files.append(("priority", (None, str(self.priority.value).encode(), "text/plain")))

        if not isinstance(self.rings, Unset):
            files.append(("rings", (None, str(self.rings.value).encode(), "text/plain")))

        return files

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        data = DataKind(d.pop("data"))

        file = File(payload=BytesIO(d.pop("file")))

        scanner_id = d.pop("scanner_id")

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

        angles_deg = d.pop("angles_deg", UNSET)

        averaged_rows = d.pop("averaged_rows", UNSET)

        dataset = d.pop("dataset", UNSET)

        _faulty_cells = d.pop("faulty_cells", UNSET)
        faulty_cells: FaultyCells | Unset
        if isinstance(_faulty_cells, Unset):
            faulty_cells = UNSET
        else:
            faulty_cells = FaultyCells(_faulty_cells)

        name = d.pop("name", UNSET)

        phantom_id = d.pop("phantom_id", UNSET)

        phantom_rows = d.pop("phantom_rows", UNSET)

        _priority = d.pop("priority", UNSET)
        priority: Priority | Unset
        if isinstance(_priority, Unset):
            priority = UNSET
        else:
            priority = Priority(_priority)

        _rings = d.pop("rings", UNSET)
        rings: RingRemoval | Unset
        if isinstance(_rings, Unset):
            rings = UNSET
        else:
            rings = RingRemoval(_rings)

        scan_form = cls(
            data=data,
            file=file,
            scanner_id=scanner_id,
            air=air,
            align_rows=align_rows,
            angles_deg=angles_deg,
            averaged_rows=averaged_rows,
            dataset=dataset,
            faulty_cells=faulty_cells,
            name=name,
            phantom_id=phantom_id,
            phantom_rows=phantom_rows,
            priority=priority,
            rings=rings,
        )

        return scan_form
