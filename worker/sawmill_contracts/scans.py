"""Scans: projection stacks, uploaded as files, read and prepared by a job."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Self

from pydantic import AfterValidator, Field, StringConstraints, model_validator

from sawmill_contracts import kinds
from sawmill_contracts.geometry import PositiveMm
from sawmill_contracts.reasons import CodedReason
from sawmill_contracts.row_ranges import Rows
from sawmill_platform.contracts import patterns
from sawmill_platform.contracts.base import Contract, Identifier, Name, Sha256, Stamped
from sawmill_platform.contracts.kind_declarations import UploadedKind
from sawmill_vocabulary import AirCorrection, DataKind, FaultyCells, ObjectTurns, RingRemoval, RowAlignment
from sawmill_vocabulary.messages import N_


class PrepareOptions(Contract):
    """Corrections of the data on reading. Counts are prepared; declared line integrals are used as they are."""

    air: AirCorrection = Field(
        AirCorrection.AUTO,
        description="Level of the air at the detector's ends: one constant a row (background), or one for each view "
        "where the level drifts (views). auto: views for counts, off for line integrals.",
        examples=["auto"],
    )
    faulty_cells: FaultyCells = Field(
        FaultyCells.AUTO,
        description="Dead and hot cells: bridged from their neighbours, or kept. auto: bridge counts, keep line "
        "integrals.",
        examples=["auto"],
    )
    rings: RingRemoval = Field(
        RingRemoval.OFF,
        description="Remove rings that unequal cells leave; growth rings about the rotation centre are weakened too.",
        examples=["off"],
    )
    align_rows: RowAlignment = Field(
        RowAlignment.OFF,
        description="Alignment of views that lost rows at the top or bottom (NaN, in counts also zero): along the log "
        "by their profile of row sums, or by features matched between views.",
        examples=["off"],
    )


# Number of rows of any detector, or of all rows of a log along its length.
MOST_AVERAGED_ROWS = 100_000


class ScanState(StrEnum):
    """State of a scan: a job reads the upload before it can be used."""

    INGESTING = "ingesting"
    READY = "ready"
    REFUSED = "refused"


Dataset = Annotated[
    Name | None,
    Field(
        description="Path or variable of the projections, where the file holds several. Null: not given.",
        examples=["/entry/data/data"],
    ),
]
# Stripped last: the limit holds for the text as it was sent, blanks included.
_Angles = Annotated[str, StringConstraints(max_length=100_000, strip_whitespace=False), AfterValidator(str.strip)]
AnglesText = Annotated[
    _Angles | None,
    Field(
        description="View angles: START:STEP in degrees, or every view's angle separated by commas; for a file that "
        "carries none.",
        examples=["0.5:1"],
        json_schema_extra={"pattern": patterns.LINE},
    ),
]


Transpose = Annotated[
    bool,
    Field(
        description="Whether the file's axes are in reverse order: (detector, views) as MATLAB's radon writes a "
        "sinogram, or (detector, rows, views). The same holds for its flat and dark fields and `deviations`.",
        examples=[False],
    ),
]


Axes = Annotated[
    str | None,
    Field(
        description="Order of the file's axes, the first one first: an order of views, rows and cells, or of views and "
        "cells. An alternative to `transpose`. The same holds for its flat and dark fields and `deviations`. Null: the "
        "order that the file states, else (views, rows, cells).",
        pattern="^(views|rows|cells)(,(views|rows|cells)){1,2}$",
        examples=["rows,views,cells"],
    ),
]


class ScanFileOptions(PrepareOptions):
    """Options of reading a file. What the file itself carries needs no repeating, and may not be contradicted."""

    data: DataKind = Field(description="Kind of the numbers; never guessed.", examples=["counts"])
    dataset: Dataset = None
    angles_deg: AnglesText = None
    transpose: Transpose = False
    axes: Axes = None
    averaged_rows: int | None = Field(
        None,
        ge=1,
        le=MOST_AVERAGED_ROWS,
        description="Number of detector rows that each line integral is the mean of; the file is (views, detector). "
        "NaN masks a ray; an array `deviations` next to the line integrals, in NPZ, MAT or HDF5, has their standard "
        "deviations. Null: rows as they were measured.",
        examples=[1000],
    )

    @model_validator(mode="after")
    def _are_averaged_as_line_integrals(self) -> Self:
        if self.averaged_rows is None:
            return self
        if self.data is DataKind.COUNTS:
            msg = (
                "averaged_rows goes with line-integrals, not counts: -ln of a mean is not the mean of -ln, so take "
                "-ln((counts - dark) / (flat - dark)) of every row first, average that over the rows and send it"
            )
            raise ValueError(msg)
        if self.align_rows is not RowAlignment.OFF:
            msg = (
                f"align_rows {self.align_rows.value!r} moves rows, which averaged_rows says are averaged: leave it out"
            )
            raise ValueError(msg)
        return self


class UnregisteredScanOptions(ScanFileOptions):
    """Options of reading a file without a service; a service knows the pitches and takes one file a scan."""

    detector_pitch_mm: PositiveMm | None = Field(
        None, description="Distance between detector cells; needed where the file does not carry the distance."
    )
    row_pitch_mm: PositiveMm | None = Field(None, description="Distance between detector rows.")
    detector_arc_radius_mm: PositiveMm | None = Field(
        None, description="Radius of the detector, where its cells lie on an arc; the distance of cells is along it."
    )
    object_turns: ObjectTurns = Field(
        ObjectTurns.IN_ONE_SCAN,
        description="When the object turns: in one scan, on a turntable, or between passages, one for each view.",
    )
    follow_links: bool = Field(
        default=False,
        description="Whether HDF5 files are read that links, virtual datasets and raw data of the file lead to.",
    )
    flats: Path | None = Field(
        None, description="File or folder with the flat fields of counts, where the scan's file carries none."
    )
    darks: Path | None = Field(
        None, description="File or folder with the dark fields of counts, where the scan's file carries none."
    )


class ScanSpec(ScanFileOptions):
    """Description of a file by the client that uploads it."""

    scanner_id: Identifier = Field(description="Id of the scanner that made the scan.")
    name: Name = Field("scan", description="Name for people.", examples=["phantom of week 10"])
    phantom_id: Identifier | None = Field(
        None, description="Id of the phantom in this scan; null for a scan without one.", examples=["l-shape"]
    )
    phantom_rows: Rows | None = Field(None, description="Rows that show the phantom; null: they are found.")


class ScanShape(Contract):
    """Lengths of the projection stack (view, row, detector)."""

    views: int = Field(description="Number of views.", examples=[360])
    rows: int = Field(description="Number of detector rows.", examples=[16])
    detector: int = Field(description="Number of detector cells.", examples=[768])

    @property
    def lengths(self) -> tuple[int, int, int]:
        """Number of views, rows and cells, in the axis order of the stack."""
        return self.views, self.rows, self.detector


UsableRows = Annotated[
    tuple[int, int] | None,
    Field(
        description="First usable row and the one after the last, where views lost rows; null: all rows.",
        examples=[(2, 14)],
    ),
]


ViewsLeftOut = Annotated[
    tuple[int, ...],
    Field(description="Numbers of the views, from 0, that are corrupt: they are not used.", examples=[[]]),
]


class ReadingRemarks(Contract):
    """Remarks on a file that was read as a scan."""

    remarks: list[str] = Field(
        [],
        description="Changes that are made to the data on reading, and what the file lacks.",
        examples=[["1 images marked invalid (image_key 3) were left out."]],
    )
    coded_remarks: list[CodedReason] = Field(
        [], description="The remarks as codes and values; empty where an earlier version read the file."
    )

    @property
    def remarks_with_codes(self) -> list[CodedReason]:
        """The remarks with their codes; without codes where an earlier version read the file."""
        return CodedReason.all_of(self.coded_remarks, self.remarks)

    @property
    def reasons(self) -> tuple[str, ...]:
        """The remarks, with words in every language where this version knows their codes."""
        return tuple(each.text for each in self.remarks_with_codes)


class ScanReading(ReadingRemarks):
    """Result of the job that read an upload."""

    format: str = Field(description="Format of the file.", examples=["hdf5-nxtomo"])
    shape: ScanShape = Field(description="Size of the projection stack.")
    angular_range_deg: tuple[float, float] = Field(
        description="First and last view's angle, degrees.", examples=[[0.0, 359.0]]
    )
    usable_rows: UsableRows = None
    views_left_out: ViewsLeftOut = ()


class Scan(Stamped, ScanSpec, ReadingRemarks):
    """A scan in its present state."""

    state: ScanState = Field(description="Whether the scan can be used.", examples=["ready"])
    reason: str | None = Field(
        None,
        description="Reason why the file was refused, in one sentence. Null: it was not refused.",
        examples=["no angles: the file carries none and none were given"],
    )
    size_bytes: int = Field(description="Size of the file, bytes.", examples=[8861696])
    sha256: Sha256 = Field(description="SHA-256 of the file, in hexadecimal digits.")
    format: str | None = Field(
        None, description="Format of the file. Null: it has not been read.", examples=["hdf5-nxtomo"]
    )
    shape: ScanShape | None = Field(None, description="Size of the projection stack. Null: it has not been read.")
    angular_range_deg: tuple[float, float] | None = Field(
        None, description="First and last view's angle, degrees. Null: it has not been read.", examples=[[0.0, 359.0]]
    )
    usable_rows: UsableRows = None
    views_left_out: ViewsLeftOut = ()
    job_id: Identifier = Field(description="Id of the job that reads the file.")


DECLARATION = UploadedKind(
    kind=kinds.INGEST, noun="scan", label=N_("Reading a scan"), result=ScanReading, upload="file"
)
