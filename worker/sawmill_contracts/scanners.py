"""Scanners: known constants, search bounds, tolerances, the active calibration."""

from typing import Annotated, Self

from pydantic import ConfigDict, Field, model_validator

from sawmill_contracts.geometry import SMALLEST_MM, GivenTheta, GivenThetaBounds, PositiveMm, ScannerConstants
from sawmill_contracts.watched_folders import WatchedFolder
from sawmill_platform.contracts.base import Contract, Identifier, Name, Stamped
from sawmill_platform.contracts.given import Given
from sawmill_vocabulary import Handedness, Rotation, ThetaBounds


class Tolerances(Contract):
    """Tolerances of the mill. A calibration beyond one of them is not a pass."""

    predicted_ray_error_mm: PositiveMm = Field(
        0.1,
        description="Limit of the predicted ray error, mm: a calibration passes where `upper_95` is below the "
        "limit, and is to be watched where only the RMS is.",
    )
    scale_percent: Annotated[float, Field(gt=0, le=100)] = Field(
        0.5,
        description="Limit of the scale uncertainty, per cent: a calibration whose `scale_uncertainty_percent` (95 "
        "%) is beyond the limit is to be watched, and a larger change of scale between two calibrations is a "
        "movement.",
    )
    ray_change_mm: PositiveMm = Field(
        0.5, description="RMS ray distance between two calibrations up to which nothing moved, mm."
    )
    angle_change_deg: Annotated[float, Field(gt=0, le=180)] | None = Field(
        None,
        description="Change of the first angle up to which nothing moved, degrees; null: no limit, as the angle "
        "turns with the phantom's mounting.",
        examples=[0.5],
    )


class AlarmLimits(Contract):
    """Times without scans after which an alarm opens. An expired phantom needs no limit."""

    phantom_scan_every_days: Annotated[float, Field(gt=0, le=3660)] | None = Field(
        None, description="Number of days without a phantom scan. Null: no alarm.", examples=[14.0]
    )
    quiet_after_hours: Annotated[float, Field(gt=0, le=8784)] | None = Field(
        None, description="Number of hours without any scan. Null: no alarm.", examples=[24.0]
    )


class ScannerSpec(Contract):
    """Description of a scanner by its owner."""

    name: Name = Field(examples=["Line 2"], description="Name for people.")
    constants: ScannerConstants = Field(description="Known constants of the scanner, which no calibration determines.")
    bounds: ThetaBounds | None = Field(
        None, description="Search bounds of theta; null: wherever the phantom can be seen."
    )
    tolerances: Tolerances = Field(Tolerances(), description="Tolerances of a calibration.")
    log_radius_mm: PositiveMm | None = Field(
        None,
        description="Radius of the largest log, mm: the disc around the rotation centre in which ray errors are "
        "counted. Null: radius of the smallest disc that holds the phantom at its measured position, at most 150 mm.",
        examples=[150.0],
    )
    alarms: AlarmLimits = Field(AlarmLimits(), description="Times without scans after which an alarm opens.")
    handedness: Handedness | None = Field(
        None,
        description="Handedness, from which end a phantom is seen. Null: every calibration tries both.",
        examples=["as-drawn"],
    )
    rotation: Rotation | None = Field(
        None, description="Sense of rotation. Null: every calibration tries both.", examples=["as-given"]
    )
    watched_folder: WatchedFolder | None = Field(
        None, description="Folder into which the scanner writes its scans. Null: its software sends them."
    )
    imported_theta: GivenTheta | None = Field(
        None,
        description="Geometry of another program, not checked, which the scanner uses until a calibration is active, "
        "with `rotation` and `handedness`. Drift checks against it have no verdict. Null: none.",
    )


class ScannerRequest(ScannerSpec, Given):
    """A scanner in a request; an earlier version accepted what is refused here."""

    bounds: GivenThetaBounds | None = Field(
        None, description="Search bounds of theta; null: wherever the phantom can be seen."
    )

    @model_validator(mode="after")
    def _can_be_built(self) -> Self:
        for name, least_mm in SMALLEST_MM.items():
            value_mm = getattr(self.constants, name)
            if value_mm is not None and value_mm < least_mm:
                raise ValueError(f"constants.{name} must be at least {least_mm:g}, not {value_mm:g}")
        return self

    @model_validator(mode="after")
    def _no_log_holds_the_source(self) -> Self:
        radius_mm, source_mm = self.log_radius_mm, self.constants.source_to_cor_mm
        if radius_mm is not None and radius_mm >= source_mm:
            raise ValueError(f"log_radius_mm {radius_mm:g} must be less than constants.source_to_cor_mm {source_mm:g}")
        return self


class StoredScanner(Stamped, ScannerSpec):
    """A scanner as it is stored."""

    model_config = ConfigDict(title="Scanner")

    active_calibration_id: Identifier | None = Field(
        None, description="Id of the calibration that reconstructions use unless they name another. Null: none yet."
    )
