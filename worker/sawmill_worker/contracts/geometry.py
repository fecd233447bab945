"""The scanner's constants, theta, the source frame: DESIGN section 3 in words that cross a boundary."""

from typing import Annotated

from pydantic import AfterValidator, Field, model_validator

from sawmill_worker.contracts.base import Contract, CoordinateMm, PositiveMm, Range, check_range


class ScannerConstants(Contract):
    """What is known of a scanner without calibrating it."""

    source_to_cor_mm: PositiveMm = Field(description="r_S, source to centre of rotation.", examples=[859.46])
    num_detector_pixels: Annotated[int, Field(ge=8, le=65536)] = Field(
        description="Cells of the detector.", examples=[768]
    )
    detector_pitch_mm: PositiveMm = Field(description="Distance between detector cells.", examples=[1.502864583])
    row_pitch_mm: PositiveMm | None = Field(
        None, description="Distance between detector rows. Left out where slices have no spacing.", examples=[2.0]
    )


class ThetaBounds(Contract):
    """Where theta is searched; the published bounds by default. The first angle is free over the full turn."""

    detector_to_cor_mm: Range = (500.0, 1000.0)
    source_shift_mm: Range = (-500.0, 500.0)
    detector_shift_mm: Range = (-500.0, 500.0)
    detector_tilt: Range = (-1.0, 1.0)


def _as_fields(given: object) -> object:
    """A model without bounds is given, too: its values are held against them."""
    return given.model_dump() if isinstance(given, Contract) else given


Slope = Annotated[float, Field(ge=-10, le=10)]
# Ranges that `ThetaBounds` may have where they are given.
CoordinateRange = Annotated[tuple[CoordinateMm, CoordinateMm], AfterValidator(check_range)]


class GivenThetaBounds(ThetaBounds):
    """Where somebody wants theta to be searched: within what a scanner can be."""

    _unbounded = model_validator(mode="before")(_as_fields)

    detector_to_cor_mm: Annotated[
        tuple[Annotated[float, Field(ge=0, le=1e5)], PositiveMm], AfterValidator(check_range)
    ] = (500.0, 1000.0)
    source_shift_mm: CoordinateRange = (-500.0, 500.0)
    detector_shift_mm: CoordinateRange = (-500.0, 500.0)
    detector_tilt: Annotated[tuple[Slope, Slope], AfterValidator(check_range)] = (-1.0, 1.0)


class Theta(Contract):
    """The five numbers that cannot be measured by hand."""

    initial_angle_rad: float = Field(description="alpha0, in [0, 2 pi).")
    detector_to_cor_mm: float = Field(description="r_D.")
    source_shift_mm: float = Field(description="h_S.")
    detector_shift_mm: float = Field(description="h_D, counted the other way than h_S.")
    detector_tilt: float = Field(description="alpha_D, a slope: the tilt angle is its arctangent.")


class GivenTheta(Theta):
    """A theta as somebody gives it: within what a scanner can be, source and detector on either side of the COR."""

    _unbounded = model_validator(mode="before")(_as_fields)

    initial_angle_rad: Annotated[float, Field(ge=-1000, le=1000)] = Field(description="alpha0; counts modulo 2 pi.")
    detector_to_cor_mm: PositiveMm = Field(description="r_D; the source stands on the other side.")
    source_shift_mm: CoordinateMm = Field(description="h_S.")
    detector_shift_mm: CoordinateMm = Field(description="h_D, counted the other way than h_S.")
    detector_tilt: Slope = Field(description="alpha_D, a slope: the tilt angle is its arctangent.")


class SourceFrame(Contract):
    """The same geometry with the source on the axis: what the data can see."""

    psi_rad: float = Field(description="First angle in the source frame.")
    source_distance_mm: float = Field(description="R, source to centre of rotation along the axis.")
    source_to_detector_mm: float = Field(description="SDD along the ray through the centre of rotation.")
    cor_column_mm: float = Field(description="u_c, where the centre of rotation falls on the detector.")
    tilt_rad: float = Field(description="tau, tilt of the detector against that ray's normal.")
    magnification: float = Field(description="SDD / R.")


class ThetaDeviation(Contract):
    """Standard deviations of theta; null where the source shift is not resolved."""

    initial_angle_rad: float | None
    detector_to_cor_mm: float | None
    source_shift_mm: float | None
    detector_shift_mm: float | None
    detector_tilt: float | None


class SourceFrameDeviation(Contract):
    """Standard deviations of the source frame; null for a parameter that was held fixed."""

    psi_rad: float | None
    source_distance_mm: float | None
    source_to_detector_mm: float | None
    cor_column_mm: float | None
    tilt_rad: float | None
    magnification: float | None
