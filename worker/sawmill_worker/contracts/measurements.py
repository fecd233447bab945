"""What each calibration and each drift check measured of its scanner, one row each: charts over months show them."""

from datetime import datetime
from enum import StrEnum
from typing import NamedTuple

from pydantic import Field

from sawmill_worker.contracts.base import Contract, Identifier, Time
from sawmill_worker.contracts.choices import Verdict


class MeasurementKind(StrEnum):
    """What measured."""

    CALIBRATION = "calibration"
    DRIFT = "drift"


class Measurement(Contract):
    """What one calibration or drift check that succeeded measured; null where it does not show a value."""

    number: int = Field(description="Grows from measurement to measurement.")
    scanner_id: Identifier
    at: Time = Field(description="When its job ended.")
    kind: MeasurementKind
    subject_id: Identifier = Field(description="The calibration, or the drift check.")
    against_id: Identifier | None = Field(
        description="The calibration that every change is counted from: of a calibration the one that was active then, "
        "of a drift check the one that it was asked to compare with. Null: there was none, and so no change."
    )
    ray_change_mm: float | None = Field(description="RMS distance between the rays, up to a common scale.")
    ray_change_tolerance_mm: float | None = Field(
        description="What it was held against. Null: no change, or a calibration of an earlier version."
    )
    within_tolerance: bool | None = Field(description="Null: no change, or too uncertain to tell.")
    scale_change_percent: float | None
    cor_column_mm: float = Field(description="u_c, where the centre of rotation falls on the detector.")
    cor_column_change_mm: float | None
    tilt_deg: float = Field(description="tau, tilt of the detector against the ray through the centre of rotation.")
    tilt_change_deg: float | None
    source_to_detector_mm: float = Field(description="SDD; a drift check hardly sees it.")
    source_distance_mm: float | None = Field(description="R, of a calibration alone.")
    relative_residual: float = Field(
        description="Of a calibration what its model leaves of the sinogram; of a drift check what opposite rays "
        "differ by. The two cannot be compared."
    )
    gain: float | None = Field(description="Of a calibration alone.")
    ray_error_rms_mm: float | None = Field(description="The predicted ray error, of a calibration with error bars.")
    ray_error_upper_95_mm: float | None = Field(description="What the ray error stays below in 95 of 100 cases.")
    scale_uncertainty_percent: float | None = Field(description="The image's millimetres are right to this with 95 %.")
    verdict: Verdict | None = Field(description="Of a calibration alone.")
    rays_verdict: Verdict | None = Field(description="Of a calibration alone, not of an earlier version.")


class Movement(NamedTuple):
    """What a chart draws of a measurement; the fields are those of `Measurement`."""

    scanner_id: str
    at: datetime
    kind: MeasurementKind
    subject_id: str
    against_id: str | None
    ray_change_mm: float | None
    ray_change_tolerance_mm: float | None
    within_tolerance: bool | None
    cor_column_mm: float
    cor_column_change_mm: float | None
    tilt_deg: float
    tilt_change_deg: float | None
