"""Inspections: what is in a file, what of it would be read, and what is missing."""

from collections.abc import Mapping
from datetime import timedelta
from enum import StrEnum
from typing import Any

from pydantic import Field

from sawmill_worker.contracts.base import Contract, Identifier, Name, Stamped, Time
from sawmill_worker.contracts.jobs import Failure, JobKind, JobState
from sawmill_worker.contracts.kinds import AskedKind, Operation
from sawmill_worker.contracts.scans import AnglesText, Dataset, ScanShape
from sawmill_worker.vocabulary import DataKind

# A day's work: whoever comes back after it sends the file again.
FILE_KEPT = timedelta(days=1)


class FileVerdict(StrEnum):
    """Whether a file can be read as a scan."""

    READY = "ready"
    INCOMPLETE = "incomplete"
    REFUSED = "refused"


class FilePart(Contract):
    """A group, dataset, link, variable, array, page or file, from its header; of several that are alike, all."""

    name: str = Field(description="Where it is; of several that are alike, the first and the last.")
    kind: str
    count: int = Field(1, description="The number of parts, which are alike but for the numbers in their names.")
    shape: list[int] | None = Field(None, description="In the axis order of the file.")
    type: str | None = Field(None, description="Of its numbers, or what it is instead.")
    unit: str | None = None
    stored_bytes: int | None = None
    compression: str | None = Field(None, description="The filters through which it is stored; null: none.")
    leads_to: str | None = Field(None, description="Where a link leads, or where data lie that are elsewhere.")


class ViewAngles(Contract):
    """The angles that the views would have."""

    first_deg: float
    last_deg: float
    from_file: bool = Field(description="Whether the file carries them; else they are those given.")
    file_unit: str | None = Field(None, description="That in which the file carries them.")


class InspectedReading(Contract):
    """What would be read, no sample of it being looked at yet."""

    data: DataKind | None = Field(None, description="What the numbers are, as given: no file states it reliably.")
    shape: ScanShape
    flats: int | None = Field(None, description="The number of flat fields; null: none.")
    darks: int | None = Field(None, description="The number of dark fields; null: none.")
    angles: ViewAngles | None = None
    detector_pitch_mm: float | None = None
    row_pitch_mm: float | None = None
    unused: str | None = Field(
        None, description="Values that could be a pitch or a distance; no name states what they are, none is used."
    )
    other_files: list[str] = Field([], description="Further files that would be read.")
    remarks: list[str] = Field([], description="What would be done to the data on reading.")


class MissingPart(Contract):
    """What the file does not carry, and how to give it."""

    what: str
    flag: str = Field(description="Of the command line, which gives it.")
    field: str | None = Field(
        None,
        description="What gives it to the service: a parameter of `POST /v1/scans`, or for a pitch or a distance one "
        "of the scanner's constants. Null: nothing does, and the file must carry it.",
    )
    why: str
    needed: bool = Field(default=True, description="Whether nothing can be read, or calibrated, without it.")


class InspectionResult(Contract):
    """All that is said of one file."""

    file: str
    size_bytes: int = Field(description="Of the file; of a folder, of all files in it.")
    format: str | None = Field(None, description="What the file turned out to be; null: nothing that can be read.")
    own_kind: str | None = Field(None, description="scan, volume or calibration, where this product wrote the file.")
    verdict: FileVerdict
    parts: list[FilePart]
    parts_left_out: int = Field(0, description="Parts beyond the most that are listed.")
    listing_ended: str | None = Field(None, description="Why the list of parts is not complete, where it is not.")
    reading: InspectedReading | None = None
    missing: list[MissingPart] = Field([], description="What the file does not carry.")
    refusal: Failure | None = Field(None, description="Why the file would be refused, however it is read.")


class InspectionOptions(Contract):
    """How the file would be read, as far as it is known: as for a scan, and nothing of it is needed."""

    data: DataKind | None = Field(None, description="What the numbers are; null: not given.")
    dataset: Dataset = None
    angles_deg: AnglesText = None


class InspectedFile(InspectionOptions):
    """The file beside them."""

    name: Name = "file"
    size_bytes: int
    sha256: str


class InspectionLinks(Contract):
    """Where it hangs together."""

    self: str
    job: str


class Inspection(Stamped):
    """An inspection as it stands. It succeeds for a file that cannot be read too: its result has the reason."""

    state: JobState
    job_id: Identifier
    options: InspectedFile
    file_kept_until: Time = Field(description="Until then scans can be made of its file.")
    result: InspectionResult | None = None
    failure: Failure | None = None
    links: InspectionLinks | None = None


def _read(record: Mapping[str, Any]) -> Inspection:
    stored = {name: record[name] for name in Inspection.model_fields if name in record}
    return Inspection.model_validate(stored | {"file_kept_until": record["created_at"] + FILE_KEPT})


DECLARATION = AskedKind(
    kind=JobKind.INSPECT,
    noun="inspection",
    upload="file",
    lighter="give a smaller file",
    ask=InspectedFile,
    options=InspectedFile,
    result=InspectionResult,
    answer=Inspection,
    read=_read,
    links=InspectionLinks,
    is_short=lambda _: True,
    processor_s=3600,
    time_limit_s=6 * 3600,
    to_ask=Operation(
        "Inspect a file before it becomes a scan",
        """\
Send the file's bytes as the body; a job finds out what is in it, what of it would be read, and what is missing.

What is missing stands there with the `field` of `POST /v1/scans` that gives it. Then `POST /v1/scans?inspection_id=…`
with an empty body makes a scan of the file, which is not sent again; so does `POST /v1/inspections?inspection_id=…`
to inspect it with another option. The file is kept for a day.
[A file to try](/examples/phantom-scan.npz).""",
    ),
    to_list=Operation("List inspections, newest first", "All of them, or those in one state."),
    to_get=Operation("Get an inspection", "Its state, and what was found once it has succeeded."),
)
