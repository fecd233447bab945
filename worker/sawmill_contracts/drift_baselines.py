"""Baselines of drift checks: the zero of later changes, measured on the first logs after a calibration."""

from pydantic import Field

from sawmill_contracts.choices import DriftMethod
from sawmill_contracts.detector_values import DetectorDeviation, DetectorGeometry
from sawmill_contracts.geometry import Covariance
from sawmill_platform.contracts.base import Contract, Time
from sawmill_vocabulary import DetectorEstimate


class KnownBaseline(Contract):
    """Mean of the first drift checks by one method after a calibration: the zero of later ones."""

    method: DriftMethod = Field(description="Method by which the drift checks compared views.", examples=["view-pairs"])
    looks: int = Field(description="Number of drift checks in the baseline, no unit.", examples=[50])
    outliers: int = Field(
        description="Number of drift checks that were left out of the mean, far from the rest; no unit.", examples=[0]
    )
    first_at: Time | None = Field(
        description="When the first drift check ended. Null: results of the command line without a time.",
        examples=["2026-03-02T05:31:04Z"],
    )
    last_at: Time | None = Field(
        description="When the last drift check ended. Null: results of the command line without a time.",
        examples=["2026-03-02T06:07:00Z"],
    )
    cor_column_offset_mm: float = Field(description="u_c of the zero less the calibrated one, mm.", examples=[0.08])
    tilt_offset_rad: float = Field(description="tau of the zero less the calibrated one, radians.", examples=[-0.0001])
    covariance: Covariance = Field(
        description="Covariance of the zero, (cor_column_mm, tilt_rad), in the products of their units, without the "
        "calibration's.",
        examples=[[[0.0001, 0.0], [0.0, 1e-08]]],
    )

    @property
    def offset(self) -> DetectorEstimate:
        """The zero less the calibrated values, with the zero's own errors."""
        return DetectorEstimate.of((self.cor_column_offset_mm, self.tilt_offset_rad), self.covariance)


class DriftBaseline(KnownBaseline):
    """Zero of a scanner's changes, and the result of a drift check against it."""

    age_hours: float | None = Field(
        None,
        description="Number of hours from the last drift check in the baseline to this one. Null: not known.",
        examples=[31.5],
    )
    ray_offset_mm: float = Field(
        description="RMS distance of the rays between the zero and the calibration, mm, in the log's disc, up to a "
        "common scale; caused by the flat field, the calibration, or a move before these logs.",
        examples=[0.04],
    )
    change: DetectorGeometry = Field(
        description="Measured values less the zero; for the distance, measured less calibrated."
    )
    change_standard_deviation: DetectorDeviation = Field(
        description="Standard deviations of the change, from this scan's errors and the zero's."
    )
    significance: DetectorDeviation = Field(description="Each change in units of its standard deviation.")
