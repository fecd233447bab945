"""What each calibration and each drift check measured of its scanner, one row each: charts over months show them."""

from datetime import datetime
from enum import StrEnum
from typing import NamedTuple

from pydantic import Field

from sawmill_contracts.choices import DriftMethod, Verdict
from sawmill_platform.contracts.base import Contract, Identifier, Time


class MeasurementKind(StrEnum):
    """What measured."""

    CALIBRATION = "calibration"
    DRIFT = "drift"


class Measurement(Contract):
    """What one calibration or drift check that succeeded measured; null where it does not show a value."""

    number: int = Field(
        description="Number of the measurement; it grows from measurement to measurement.", examples=[17]
    )
    scanner_id: Identifier = Field(description="Id of the scanner.", examples=["example"])
    at: Time = Field(description="When its job ended.", examples=["2026-03-02T05:31:04Z"])
    kind: MeasurementKind = Field(description="What measured.", examples=["calibration"])
    subject_id: Identifier = Field(description="Id of the calibration, or of the drift check.", examples=["example"])
    against_id: Identifier | None = Field(
        description="The calibration that every change is counted from: of a calibration the one that was active then, "
        "of a drift check the one that it was asked to compare with. Null: there was none, and so no change.",
        examples=["example"],
    )
    ray_change_mm: float | None = Field(
        description="RMS distance between the rays, up to a common scale, mm. Of a drift check with a baseline it is "
        "counted from that, as is `within_tolerance`. Null: there was nothing to compare with.",
        examples=[0.03],
    )
    ray_change_tolerance_mm: float | None = Field(
        description="What it was held against. Null: no change, or a calibration of an earlier version.", examples=[0.5]
    )
    within_tolerance: bool | None = Field(description="Null: no change, or too uncertain to tell.", examples=[True])
    scale_change_percent: float | None = Field(
        description="Change of the image's size, per cent. Null: no change, or not known.", examples=[0.05]
    )
    cor_column_mm: float = Field(
        description="u_c, where the centre of rotation falls on the detector.", examples=[-209.1]
    )
    cor_column_standard_deviation_mm: float | None = Field(
        None, description="Of u_c, mm. Null: no error bars.", examples=[0.02]
    )
    cor_column_change_mm: float | None = Field(description="Change of u_c, mm. Null: no change.", examples=[0.02])
    tilt_deg: float = Field(
        description="tau, tilt of the detector against the ray through the centre of rotation.", examples=[-4.76]
    )
    tilt_standard_deviation_deg: float | None = Field(
        None, description="Of tau, degrees. Null: no error bars.", examples=[0.011]
    )
    tilt_change_deg: float | None = Field(description="Change of tau, degrees. Null: no change.", examples=[0.01])
    source_to_detector_mm: float = Field(description="SDD; a drift check hardly sees it.", examples=[1619.3])
    source_to_detector_standard_deviation_mm: float | None = Field(
        None, description="Of SDD, mm. Null: no error bars, or a drift check that held it.", examples=[0.4]
    )
    source_distance_mm: float | None = Field(
        description="R, distance from the source to the centre of rotation, mm. Null: a drift check does not see it.",
        examples=[917.1],
    )
    relative_residual: float = Field(
        description="No unit. Of a calibration what its model leaves of the sinogram; of a drift check what opposite "
        "rays differ by. The two cannot be compared.",
        examples=[0.012],
    )
    gain: float | None = Field(
        description="Factor between the phantom's model and the sinogram, in 1/mm. Null: a drift check has none.",
        examples=[0.021],
    )
    ray_error_rms_mm: float | None = Field(
        description="The predicted ray error, RMS, mm. Null: a drift check, or a calibration without error bars.",
        examples=[0.02],
    )
    ray_error_upper_95_mm: float | None = Field(
        description="What the ray error stays below in 95 of 100 cases, mm. Null as before.", examples=[0.04]
    )
    scale_uncertainty_percent: float | None = Field(
        description="The image's millimetres are right to this with 95 %.", examples=[0.3]
    )
    verdict: Verdict | None = Field(description="Of a calibration. Null: a drift check.", examples=["pass"])
    rays_verdict: Verdict | None = Field(
        description="Of a calibration alone, not of an earlier version.", examples=["pass"]
    )
    cor_column_tilt_covariance_mm_deg: float | None = Field(
        None,
        description="Covariance of u_c and tau, mm times degrees, of a drift check's own errors. Null: a calibration, "
        "or an earlier version.",
        examples=[-0.0001],
    )
    method: DriftMethod | None = Field(
        None, description="How a drift check compared views. Null as before.", examples=["view-pairs"]
    )
    baseline_looks: int | None = Field(
        None,
        description="Number of drift checks in the baseline that it was compared with. Null: its change is absolute, "
        "counted from the calibration.",
        examples=[50],
    )
    baseline_age_hours: float | None = Field(
        None, description="Age of that baseline, a number of hours. Null: there was none.", examples=[31.5]
    )
    cor_column_baseline_change_mm: float | None = Field(
        None, description="Change of u_c against the baseline, mm. Null: there was none.", examples=[0.01]
    )
    tilt_baseline_change_deg: float | None = Field(
        None, description="Change of tau against the baseline, degrees. Null: there was none.", examples=[0.02]
    )
    pooled_looks: int | None = Field(
        None,
        description="Number of drift checks by this method that are pooled: this one and those before it. Null: it is "
        "in no chart, or not yet.",
        examples=[50],
    )
    pooled_cor_column_mm: float | None = Field(
        None, description="u_c, as these see it together, mm. Null as before.", examples=[-209.1]
    )
    pooled_cor_column_standard_deviation_mm: float | None = Field(
        None, description="Of that, mm. Null as before.", examples=[0.006]
    )
    pooled_tilt_deg: float | None = Field(
        None, description="tau, as these see it together, degrees. Null as before.", examples=[-4.76]
    )
    pooled_tilt_standard_deviation_deg: float | None = Field(
        None, description="Of that, degrees. Null as before.", examples=[0.004]
    )


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
    source_to_detector_mm: float | None = None
    relative_residual: float | None = None
    gain: float | None = None
    cor_column_standard_deviation_mm: float | None = None
    tilt_standard_deviation_deg: float | None = None
    source_to_detector_standard_deviation_mm: float | None = None
    pooled_cor_column_mm: float | None = None
    pooled_cor_column_standard_deviation_mm: float | None = None
    pooled_tilt_deg: float | None = None
    pooled_tilt_standard_deviation_deg: float | None = None
    baseline_looks: int | None = None
    baseline_age_hours: float | None = None
    method: str | None = None
