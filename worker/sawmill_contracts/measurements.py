"""Measurements of a scanner by calibrations and drift checks, one row each; charts over months show them."""

from datetime import datetime
from enum import StrEnum
from typing import NamedTuple

from pydantic import Field

from sawmill_contracts.choices import DriftMethod, Verdict
from sawmill_platform.contracts.base import Contract, Identifier, Time


class MeasurementKind(StrEnum):
    """Source of a measurement."""

    CALIBRATION = "calibration"
    DRIFT = "drift"


class Measurement(Contract):
    """Values that one calibration or drift check measured; null where it does not show a value."""

    number: int = Field(
        description="Number of the measurement; it grows from measurement to measurement.", examples=[17]
    )
    scanner_id: Identifier = Field(description="Id of the scanner.")
    at: Time = Field(description="Time when its job ended, RFC 3339, UTC.", examples=["2026-03-02T05:31:04Z"])
    kind: MeasurementKind = Field(description="Source of the measurement.", examples=["calibration"])
    subject_id: Identifier = Field(description="Id of the calibration, or of the drift check.")
    against_id: Identifier | None = Field(
        description="Id of the calibration that every change is counted from: for a calibration the one that was "
        "active then, for a drift check the one that it was compared with. Null: there was none, and so no change."
    )
    ray_change_mm: float | None = Field(
        description="RMS distance between the rays, up to a common scale, mm; for a drift check with a baseline "
        "counted from the baseline, as is `within_tolerance`. Null: there was nothing to compare with.",
        examples=[0.03],
    )
    ray_change_tolerance_mm: float | None = Field(
        description="Limit of `ray_change_mm`. Null: no change, or a calibration of an earlier version.", examples=[0.5]
    )
    within_tolerance: bool | None = Field(
        description="Whether the change is within tolerance. Null: no change, or too uncertain to tell.",
        examples=[True],
    )
    scale_change_percent: float | None = Field(
        description="Change of the image's size, per cent. Null: no change, or not known.", examples=[0.05]
    )
    cor_column_mm: float = Field(
        description="u_c, where the centre of rotation falls on the detector, mm.", examples=[-209.1]
    )
    cor_column_standard_deviation_mm: float | None = Field(
        None, description="Standard deviation of u_c, mm. Null: no error bars.", examples=[0.02]
    )
    cor_column_change_mm: float | None = Field(description="Change of u_c, mm. Null: no change.", examples=[0.02])
    tilt_deg: float = Field(
        description="tau, tilt of the detector against the ray through the centre of rotation, degrees.",
        examples=[-4.76],
    )
    tilt_standard_deviation_deg: float | None = Field(
        None, description="Standard deviation of tau, degrees. Null: no error bars.", examples=[0.011]
    )
    tilt_change_deg: float | None = Field(description="Change of tau, degrees. Null: no change.", examples=[0.01])
    source_to_detector_mm: float = Field(
        description="SDD, mm; only weakly determined by a drift check.", examples=[1619.3]
    )
    source_to_detector_standard_deviation_mm: float | None = Field(
        None,
        description="Standard deviation of SDD, mm. Null: no error bars, or a drift check that held SDD.",
        examples=[0.4],
    )
    source_distance_mm: float | None = Field(
        description="R, distance from the source to the centre of rotation, mm. Null: a drift check does not see it.",
        examples=[917.1],
    )
    relative_residual: float = Field(
        description="Relative residual, no unit: for a calibration of its model against the sinogram, for a drift "
        "check of opposite rays against each other. The two cannot be compared.",
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
        description="Upper 95 % limit of the RMS ray error, mm. Null: a drift check, or a calibration without error "
        "bars.",
        examples=[0.04],
    )
    scale_uncertainty_percent: float | None = Field(
        description="95 % uncertainty of the image's millimetres, per cent. Null: a drift check, or not known.",
        examples=[0.3],
    )
    verdict: Verdict | None = Field(description="Verdict on a calibration. Null: a drift check.", examples=["pass"])
    rays_verdict: Verdict | None = Field(
        description="Verdict on a calibration's rays alone. Null: a drift check, or a calibration of an earlier "
        "version.",
        examples=["pass"],
    )
    cor_column_tilt_covariance_mm_deg: float | None = Field(
        None,
        description="Covariance of u_c and tau, mm times degrees, of a drift check's own errors. Null: a calibration, "
        "or an earlier version.",
        examples=[-0.0001],
    )
    method: DriftMethod | None = Field(
        None,
        description="Method by which a drift check compared views. Null: a calibration, or an earlier version.",
        examples=["view-pairs"],
    )
    baseline_checks: int | None = Field(
        None,
        description="Number of drift checks in the baseline of this drift check. Null: its change is absolute, "
        "counted from the calibration.",
        examples=[50],
    )
    baseline_age_hours: float | None = Field(
        None, description="Age of the baseline, number of hours. Null: there was no baseline.", examples=[31.5]
    )
    cor_column_baseline_change_mm: float | None = Field(
        None, description="Change of u_c against the baseline, mm. Null: there was no baseline.", examples=[0.01]
    )
    tilt_baseline_change_deg: float | None = Field(
        None, description="Change of tau against the baseline, degrees. Null: there was no baseline.", examples=[0.02]
    )
    pooled_checks: int | None = Field(
        None,
        description="Number of drift checks by this method that are pooled: this one and those before it. Null: not "
        "in a chart, or not yet.",
        examples=[50],
    )
    pooled_cor_column_mm: float | None = Field(
        None, description="u_c from the pooled drift checks, mm. Null: not in a chart, or not yet.", examples=[-209.1]
    )
    pooled_cor_column_standard_deviation_mm: float | None = Field(
        None,
        description="Standard deviation of the pooled u_c, mm. Null: not in a chart, or not yet.",
        examples=[0.006],
    )
    pooled_tilt_deg: float | None = Field(
        None,
        description="tau from the pooled drift checks, degrees. Null: not in a chart, or not yet.",
        examples=[-4.76],
    )
    pooled_tilt_standard_deviation_deg: float | None = Field(
        None,
        description="Standard deviation of the pooled tau, degrees. Null: not in a chart, or not yet.",
        examples=[0.004],
    )


class Movement(NamedTuple):
    """Values of a measurement that a chart draws; the fields are those in `Measurement`."""

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
    baseline_checks: int | None = None
    baseline_age_hours: float | None = None
    method: str | None = None
