"""Inspections: what is in a file, what of the file would be read, and what is missing."""

from collections.abc import Mapping
from datetime import timedelta
from enum import StrEnum
from typing import Any

from pydantic import Field

from sawmill_contracts import kinds
from sawmill_contracts.kinds import AskedKind, JobAnswer, JobLinks, Operation
from sawmill_contracts.scans import AnglesText, Axes, Dataset, ReadingRemarks, ScanShape, Transpose
from sawmill_platform.contracts.base import Contract, Identifier, Name, Sha256, Time
from sawmill_platform.contracts.given import Given
from sawmill_platform.contracts.jobs import Failure
from sawmill_vocabulary import DataKind, DetectorModule
from sawmill_vocabulary.messages import N_

# A working day: after this time the client sends the file again.
FILE_KEPT = timedelta(days=1)
PICTURE_PX = 320


class FileVerdict(StrEnum):
    """Verdict on a file: whether it can be read as a scan."""

    READY = "ready"
    INCOMPLETE = "incomplete"
    REFUSED = "refused"


class ScanPicture(StrEnum):
    """Pictures of the scan in an inspected file, by the names of their files; an inspection has one at most.

    The file is `PICTURE_PX` rows of as many bytes, from 0 for black to 255 for white.
    """

    VIEW = "view.grey"
    SINOGRAM = "sinogram.grey"


class FilePart(Contract):
    """A group, dataset, link, variable, array, page or file, described by its header; similar parts are one entry."""

    name: str = Field(
        description="Path in the file; for several similar parts, the first and the last.",
        examples=["/entry/data/data"],
    )
    kind: str = Field(
        description="Type of the part, as a group, a dataset, a link, an array or a page.", examples=["dataset"]
    )
    count: int = Field(1, description="Number of parts, which are alike but for the numbers in their names.")
    shape: list[int] | None = Field(
        None, description="Lengths in the axis order of the file. Null: the part has none.", examples=[[360, 16, 768]]
    )
    type: str | None = Field(
        None, description="Type of the part's numbers, or what the part is instead.", examples=["uint16"]
    )
    unit: str | None = Field(
        None, description="Unit, as the file states it. Null: the file states none.", examples=["counts"]
    )
    stored_bytes: int | None = Field(
        None, description="Bytes that the part takes in the file. Null: not known from its header.", examples=[8847360]
    )
    compression: str | None = Field(
        None, description="Filters through which the part is stored; null: none.", examples=["gzip"]
    )
    leads_to: str | None = Field(
        None,
        description="Target of a link, or the file with data that are stored outside. Null: neither.",
        examples=["/entry/instrument/detector/data"],
    )


class ViewAngles(Contract):
    """Angles that the views would have."""

    first_deg: float = Field(description="The first view's angle, degrees.", examples=[0.0])
    last_deg: float = Field(description="The last view's angle, degrees.", examples=[359.0])
    from_file: bool = Field(
        description="Whether the file carries the angles; else they are those in the request.", examples=[True]
    )
    file_unit: str | None = Field(
        None,
        description="Unit in which the file carries the angles. Null: the file carries no angles, or states no unit.",
        examples=["deg"],
    )


class InspectedReading(ReadingRemarks):
    """Data that would be read, as the headers state them."""

    data: DataKind | None = Field(
        None, description="Kind of the numbers, as in the request: no file states it reliably.", examples=["counts"]
    )
    shape: ScanShape = Field(description="Size of the projection stack.")
    flats: int | None = Field(None, description="Number of flat fields; null: none.", examples=[10])
    darks: int | None = Field(None, description="Number of dark fields; null: none.", examples=[10])
    angles: ViewAngles | None = Field(
        None, description="The angles that the views would have. Null: the file carries none and none were given."
    )
    detector_pitch_mm: float | None = Field(
        None,
        description="Distance between neighbouring detector cells that the file states, mm. Null: the file states "
        "none.",
        examples=[1.5],
    )
    row_pitch_mm: float | None = Field(
        None,
        description="Distance between detector rows that the file states, mm. Null: the file states none.",
        examples=[2.0],
    )
    detector_modules: list[DetectorModule] = Field(
        [], description="Modules of the detector after the first that the file states; empty: it states none."
    )
    detector_arc_radius_mm: float | None = Field(
        None,
        description="Radius of the arc on which the cells lie, which the file states, mm. Null: the file states none.",
        examples=[1500.0],
    )
    unused: str | None = Field(
        None,
        description="Values that could be a pitch or a distance; no name states what they are, none is used.",
        examples=["/entry/pixel: 1.5"],
    )
    other_files: list[str] = Field([], description="Further files that would be read.", examples=[["mill-flats.h5"]])


class MissingPart(Contract):
    """Information that the file does not carry, and how to give it."""

    name: str = Field(description="Missing information, in words.", examples=["what the numbers are"])
    flag: str = Field(description="Flag of the command line that gives the information.", examples=["--data counts"])
    field: str | None = Field(
        None,
        description="Field that gives the information to the service: a parameter of `POST /v1/scans`, or for a "
        "pitch or a distance one of the scanner's constants. Null: there is none, and the file must carry the "
        "information.",
        examples=["data"],
    )
    why: str = Field(
        description="Reason why the information must be given, in words.", examples=["no file states it reliably"]
    )
    needed: bool = Field(
        default=True, description="Whether nothing can be read, or calibrated, without the information."
    )


class InspectionResult(Contract):
    """Result of a file's inspection."""

    file: str = Field(description="The file's name.", examples=["mill.h5"])
    size_bytes: int = Field(
        description="Size of the file, bytes; for a folder, of all files in it.", examples=[8861696]
    )
    format: str | None = Field(
        None, description="Format of the file; null: no readable format.", examples=["hdf5-nxtomo"]
    )
    own_kind: str | None = Field(
        None,
        description="scan, volume or calibration, where this product wrote the file. Null: another program wrote "
        "the file.",
        examples=["scan"],
    )
    calibration_id: Identifier | None = Field(
        None,
        description="Id of the calibration whose answer, as JSON, the file is. Null: the file is none, or has no id.",
        examples=[None],
    )
    verdict: FileVerdict = Field(description="Whether the file can be read as a scan.", examples=["ready"])
    parts: list[FilePart] = Field(description="Parts of the file.")
    parts_left_out: int = Field(0, description="Number of parts beyond the most that are listed.")
    listing_ended: str | None = Field(
        None,
        description="Why the list of parts is not complete. Null: it is complete.",
        examples=["the file is cut short"],
    )
    reading: InspectedReading | None = Field(None, description="Data that would be read. Null: nothing can be read.")
    missing: list[MissingPart] = Field([], description="Information that the file does not carry.")
    refusal: Failure | None = Field(
        None, description="Reason why the file would be refused, with any options. Null: the file can be read."
    )


class InspectionOptions(Contract):
    """Known options of reading the file, as for a scan; none is required."""

    data: DataKind | None = Field(None, description="Kind of the numbers; null: not given.", examples=["counts"])
    dataset: Dataset = None
    angles_deg: AnglesText = None
    transpose: Transpose = False
    axes: Axes = None


class InspectedFile(InspectionOptions):
    """Options of reading the file, with the file's name, size and checksum."""

    name: Name = Field("file", description="Name under which the file was sent.", examples=["mill.h5"])
    size_bytes: int = Field(description="Size of the file, bytes.", examples=[8861696])
    sha256: Sha256 = Field(description="SHA-256 of the file, in hexadecimal digits.")


class InspectionRequest(InspectedFile, Given):
    """A file that was sent to be inspected."""


class Inspection(JobAnswer[InspectedFile, InspectionResult, JobLinks]):
    """An inspection in its present state. It succeeds also for an unreadable file: its result has the reason."""

    file_kept_until: Time = Field(
        description="Time until which scans can be made from the file, RFC 3339, UTC.",
        examples=["2026-03-03T05:30:00Z"],
    )


def _read(record: Mapping[str, Any]) -> Inspection:
    stored = {name: record[name] for name in Inspection.model_fields if name in record}
    return Inspection.model_validate(stored | {"file_kept_until": record["created_at"] + FILE_KEPT})


DECLARATION = AskedKind(
    kind=kinds.INSPECT,
    noun="inspection",
    label=N_("Looking into a file"),
    about="Contents of a file, and what is missing, before it becomes a scan.",
    upload="file",
    lighter="give a smaller file",
    ask=InspectionRequest,
    options=InspectedFile,
    result=InspectionResult,
    answer=Inspection,
    read=_read,
    links=JobLinks,
    is_short=lambda _: True,
    processor_s=3600,
    time_limit_s=6 * 3600,
    to_ask=Operation(
        "Inspect a file before it becomes a scan",
        """\
Send the file's bytes as the body; a job finds out what is in the file, what of it would be read, and what is missing.

Each missing item is listed with the `field` of `POST /v1/scans` that gives it. Then `POST /v1/scans?inspection_id=…`
with an empty body makes a scan of the file, which is not sent again; `POST /v1/inspections?inspection_id=…` inspects
the file again with other options. The file is kept for a day.
[A file to try](/examples/phantom-scan.npz).""",
    ),
    to_list=Operation("List inspections, newest first", "All inspections, or a selection by state."),
    to_get=Operation("Get an inspection", "State of the inspection, and its result once it has succeeded."),
)
