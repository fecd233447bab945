"""The part of the geometry that a log shows, and its errors."""

from pydantic import Field

from sawmill_platform.contracts.base import Contract


class DetectorGeometry(Contract):
    """The part of the geometry that a log shows."""

    cor_column_mm: float = Field(
        description="u_c, where the centre of rotation falls on the detector.", examples=[-209.1]
    )
    tilt_rad: float = Field(
        description="tau, tilt of the detector against the ray through the centre of rotation.", examples=[-0.083]
    )
    source_to_detector_mm: float = Field(
        description="SDD along the ray through the centre of rotation; only weakly determined, and held where it is "
        "not determined.",
        examples=[1619.3],
    )


class DetectorDeviation(Contract):
    """Standard deviations, or multiples of them; null for the distance where the scan does not show it."""

    cor_column_mm: float = Field(
        description="Value for u_c, where the centre of rotation falls on the detector, mm, or in standard deviations.",
        examples=[0.05],
    )
    tilt_rad: float = Field(
        description="Value for tau, the detector's tilt, radians, or in standard deviations.", examples=[0.0004]
    )
    source_to_detector_mm: float | None = Field(
        description="Value for SDD, mm, or in standard deviations. Null: the scan does not show it.", examples=[12.0]
    )
