"""Reconstructions: what can be asked, and the answer."""

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import Field, model_validator

from worker.contracts.base import Contract, Handedness, Identifier, PositiveMm, Rotation, Rows, Stamped
from worker.contracts.geometry import Theta
from worker.contracts.jobs import Failure


class ReconstructionMethod(StrEnum):
    """Filtered back-projection."""

    FBP = "fbp"


class FilterName(StrEnum):
    """Window on the ramp."""

    RAM_LAK = "ram-lak"
    SHEPP_LOGAN = "shepp-logan"
    COSINE = "cosine"
    HAMMING = "hamming"
    HANN = "hann"


class ReconstructionOptions(Contract):
    """How to reconstruct, apart from what."""

    rows: Rows | None = Field(None, description="Rows to reconstruct, one slice each; null: all.")
    views: Annotated[int, Field(ge=3)] | None = Field(None, description="Use every (total / views)-th view; null: all.")
    method: ReconstructionMethod = ReconstructionMethod.FBP
    filter: FilterName = FilterName.HANN
    frequency_scaling: Annotated[float, Field(gt=0, le=1)] = Field(
        1.0, description="Cut-off as a fraction of the Nyquist frequency."
    )
    weighting: Literal["exact", "none"] = Field(
        "exact", description="`none` is the published pipeline's: no cosine, no distance weight."
    )
    size: Annotated[int, Field(ge=16, le=4096)] = Field(256, description="Pixels along each side.")
    field_mm: PositiveMm = Field(400.0, description="Side of the square field, centred on the rotation centre.")


class ReconstructionAsk(ReconstructionOptions):
    """Ask for a reconstruction with a calibration (the scanner's active one unless named) or with a theta."""

    scan_id: Identifier = Field(examples=["example"])
    calibration_id: Identifier | None = Field(
        None, description="Null: the scanner's active calibration, unless theta is given."
    )
    theta: Theta | None = Field(None, description="A geometry of your own, instead of a calibration.")
    rotation: Rotation | None = Field(None, description="With theta: which way the angles count.")
    handedness: Handedness | None = Field(None, description="With theta: recorded in the result.")

    @model_validator(mode="after")
    def _one_geometry(self) -> "ReconstructionAsk":
        if self.theta is not None and self.calibration_id is not None:
            msg = "give calibration_id or theta, not both"
            raise ValueError(msg)
        if self.theta is None and (self.rotation is not None or self.handedness is not None):
            msg = "rotation and handedness come with theta; a calibration carries its own"
            raise ValueError(msg)
        return self


class ReconstructionResult(Contract):
    """The answer beside the volume."""

    shape: tuple[int, int, int] = Field(description="(slice, x, y)")
    pixel_mm: float
    unit: str
    value_range: tuple[float, float] = Field(description="0.1 and 99.9 percentile over the volume.")
    theta: Theta
    rotation: Rotation
    handedness: Handedness
    views: int
    rows: tuple[int, int]
    time_s: float
    software_version: str
    input_sha256: str


class ReconstructionLinks(Contract):
    """Where its files are."""

    self: str
    job: str
    volume: str
    first_slice: str


class Reconstruction(Stamped):
    """A reconstruction as it stands."""

    state: Literal["queued", "running", "succeeded", "failed", "cancelled"]
    scanner_id: Identifier
    scan_id: Identifier
    calibration_id: Identifier | None
    job_id: Identifier
    options: ReconstructionAsk
    result: ReconstructionResult | None = None
    failure: Failure | None = None
    links: ReconstructionLinks | None = None
