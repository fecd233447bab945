"""What `sawmill inspect` says of a file: what is in it, what of it would be read, and what is missing."""

from enum import StrEnum

from pydantic import Field

from sawmill_worker.contracts.base import Contract
from sawmill_worker.contracts.jobs import Failure
from sawmill_worker.contracts.scans import ScanShape
from sawmill_worker.vocabulary import DataKind


class Verdict(StrEnum):
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
    flag: str
    why: str
    needed: bool = Field(default=True, description="Whether nothing can be read, or calibrated, without it.")


class InspectionResult(Contract):
    """All that is said of one file."""

    file: str
    size_bytes: int = Field(description="Of the file; of a folder, of all files in it.")
    format: str | None = Field(None, description="What the file turned out to be; null: nothing that can be read.")
    own_kind: str | None = Field(None, description="scan, volume or calibration, where this product wrote the file.")
    verdict: Verdict
    parts: list[FilePart]
    parts_left_out: int = Field(0, description="Parts beyond the most that are listed.")
    listing_ended: str | None = Field(None, description="Why the list of parts is not complete, where it is not.")
    reading: InspectedReading | None = None
    missing: list[MissingPart] = Field([], description="What the file does not carry.")
    refusal: Failure | None = Field(None, description="Why the file would be refused, however it is read.")
