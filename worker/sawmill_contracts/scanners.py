"""Scanners: known constants, search bounds, tolerances, the active calibration."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from sawmill_contracts.geometry import SMALLEST_MM, GivenThetaBounds, ScannerConstants
from sawmill_platform.contracts.base import Contract, Identifier, Name, PositiveMm, Stamped
from sawmill_platform.contracts.given import Given
from sawmill_vocabulary import Handedness, Rotation, ThetaBounds


class Tolerances(Contract):
    """What the mill accepts. A calibration beyond one of them is not a pass."""

    predicted_ray_error_mm: PositiveMm = Field(
        0.1,
        description="A calibration passes where its predicted ray error is below this with 95 % (`upper_95`), and is "
        "to be watched where only the RMS is.",
        examples=[0.1],
    )
    scale_percent: Annotated[float, Field(gt=0, le=100)] = Field(
        0.5,
        description="What the image's millimetres may be off by: a calibration whose `scale_uncertainty_percent` "
        "(95 %) is beyond it is to be watched, and a change of scale between two calibrations beyond it is a movement.",
        examples=[0.5],
    )
    ray_change_mm: PositiveMm = Field(
        0.5, description="RMS ray distance between two calibrations up to which nothing moved.", examples=[0.5]
    )
    angle_change_deg: Annotated[float, Field(gt=0, le=180)] | None = Field(
        None,
        description="Change of the first angle up to which nothing moved; null: it turns with the phantom's mounting.",
        examples=[0.5],
    )


class AlarmLimits(Contract):
    """After how long something that has not come opens an alarm. An expired phantom needs no limit."""

    phantom_scan_every_days: Annotated[float, Field(gt=0, le=3660)] | None = Field(
        None, description="Number of days without a phantom scan. Null: no alarm.", examples=[14.0]
    )
    quiet_after_hours: Annotated[float, Field(gt=0, le=8784)] | None = Field(
        None, description="Number of hours without any scan. Null: no alarm.", examples=[24.0]
    )


class ScannerSpec(Contract):
    """A scanner as its owner describes it."""

    name: Name = Field(examples=["Line 2"], description="What people call it.")
    constants: ScannerConstants = Field(description="What is known of the scanner without calibrating it.")
    bounds: ThetaBounds | None = Field(
        None, description="Where theta is searched; null: wherever the phantom can be seen."
    )
    tolerances: Tolerances = Field(Tolerances(), description="What a calibration may be off by.")
    log_radius_mm: PositiveMm | None = Field(
        None,
        description="Radius of the largest log: the disc around the rotation centre in which ray errors are counted. "
        "Null: that of the smallest which holds the phantom where it stood, at most 150 mm.",
        examples=[150.0],
    )
    alarms: AlarmLimits = Field(AlarmLimits(), description="When its silence is an alarm.")
    handedness: Handedness | None = Field(
        None, description="Null: every calibration tries both.", examples=["as-drawn"]
    )
    rotation: Rotation | None = Field(None, description="Null: every calibration tries both.", examples=["as-given"])


class ScannerAsk(ScannerSpec, Given):
    """A scanner that is to be taken in; an earlier version took what is refused here."""

    bounds: GivenThetaBounds | None = Field(
        None, description="Where theta is searched; null: wherever the phantom can be seen."
    )

    @model_validator(mode="after")
    def _can_be_built(self) -> Self:
        for name, least_mm in SMALLEST_MM.items():
            value_mm = getattr(self.constants, name)
            if value_mm is not None and value_mm < least_mm:
                msg = f"constants.{name} must be at least {least_mm:g}, not {value_mm:g}"
                raise ValueError(msg)
        return self

    @model_validator(mode="after")
    def _no_log_holds_the_source(self) -> Self:
        radius_mm, source_mm = self.log_radius_mm, self.constants.source_to_cor_mm
        if radius_mm is not None and radius_mm >= source_mm:
            msg = f"log_radius_mm {radius_mm:g} must be less than constants.source_to_cor_mm {source_mm:g}"
            raise ValueError(msg)
        return self


class StoredScanner(Stamped, ScannerSpec):
    """A scanner as it is stored."""

    active_calibration_id: Identifier | None = Field(
        None, description="The calibration that reconstructions use unless another is given.", examples=["example"]
    )
