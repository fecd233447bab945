"""The geometry's values in requests and answers, and the options of a simulated scan."""

from dataclasses import field, fields
from typing import Annotated

from pydantic import AfterValidator, Field, WithJsonSchema, computed_field, model_validator
from pydantic.dataclasses import dataclass

from sawmill_platform.contracts.base import Contract
from sawmill_vocabulary import LARGEST_MM, CoordinateMm, Scanner, SourceFrame, Theta, ThetaBounds
from sawmill_vocabulary.outlines import described


def _check_range(value: tuple[float, float]) -> tuple[float, float]:
    if not value[0] < value[1]:
        raise ValueError(f"a range must be [low, high] with low < high, not {list(value)}")
    return value


def _check_square(rows: list[list[float]]) -> list[list[float]]:
    lengths = [len(row) for row in rows]
    if not rows or lengths != [len(rows)] * len(rows):
        raise ValueError(
            f"a covariance must have as many numbers in each row as it has rows, not {lengths} in {len(rows)} rows"
        )
    return rows


Covariance = Annotated[list[list[float]], AfterValidator(_check_square)]
# Of (psi, R, SDD, u_c, tau) in rad and mm.
COVARIANCE_EXAMPLE = [
    [1e-08, 0, 0, 0, 0],
    [0, 0.04, 0.07, 0, 0],
    [0, 0.07, 0.12, 0, 0],
    [0, 0, 0, 0.0004, 1e-07],
    [0, 0, 0, 1e-07, 4e-08],
]
PositiveMm = Annotated[float, Field(gt=0, le=LARGEST_MM)]
# A detector's cell is larger than the wavelength of light, and the source is outside of any log.
SMALLEST_MM = {"source_to_cor_mm": 1.0, "detector_pitch_mm": 1e-3, "row_pitch_mm": 1e-3}
# The contract states these bounds, and `ScannerRequest` checks them: earlier versions have stored smaller values.
_SourceMm = Annotated[
    PositiveMm, WithJsonSchema({"type": "number", "minimum": SMALLEST_MM["source_to_cor_mm"], "maximum": LARGEST_MM})
]
_PitchMm = Annotated[
    PositiveMm, WithJsonSchema({"type": "number", "minimum": SMALLEST_MM["row_pitch_mm"], "maximum": LARGEST_MM})
]
_SCANNER = {one.name: one.metadata for one in fields(Scanner)}


@dataclass(frozen=True)
class ScannerConstants(Scanner):
    """Known constants of a scanner, which no calibration determines."""

    source_to_cor_mm: _SourceMm = field(metadata=_SCANNER["source_to_cor_mm"])
    detector_pitch_mm: _PitchMm = field(metadata=_SCANNER["detector_pitch_mm"])
    row_pitch_mm: _PitchMm | None = field(
        default=None,
        metadata=described(
            "Distance between detector rows, mm. Left out where slices have no spacing.", examples=[2.0]
        ),
    )


# Bounds of the vocabulary's fields, for types with tighter bounds.
_BOUNDS = {one.name: one.metadata for one in fields(ThetaBounds)}
_THETA = {one.name: one.metadata for one in fields(Theta)}

Slope = Annotated[float, Field(ge=-10, le=10)]
# Ranges that `ThetaBounds` may have in a request.
CoordinateRange = Annotated[tuple[CoordinateMm, CoordinateMm], AfterValidator(_check_range)]
DistanceRange = Annotated[tuple[Annotated[float, Field(ge=0, le=LARGEST_MM)], PositiveMm], AfterValidator(_check_range)]
SlopeRange = Annotated[tuple[Slope, Slope], AfterValidator(_check_range)]


@dataclass(frozen=True)
class GivenThetaBounds(ThetaBounds):
    """Bounds of theta in a request: within what a scanner can be."""

    detector_to_cor_mm: DistanceRange = field(
        default=ThetaBounds.detector_to_cor_mm, metadata=_BOUNDS["detector_to_cor_mm"]
    )
    source_shift_mm: CoordinateRange = field(default=ThetaBounds.source_shift_mm, metadata=_BOUNDS["source_shift_mm"])
    detector_shift_mm: CoordinateRange = field(
        default=ThetaBounds.detector_shift_mm, metadata=_BOUNDS["detector_shift_mm"]
    )
    detector_tilt: SlopeRange = field(default=ThetaBounds.detector_tilt, metadata=_BOUNDS["detector_tilt"])


@dataclass(frozen=True)
class GivenTheta(Theta):
    """A theta in a request: within what a scanner can be, source and detector on either side of the COR."""

    initial_angle_rad: Annotated[float, Field(ge=-1000, le=1000)] = field(
        metadata=described("alpha0, rad; counts modulo 2 pi.", examples=[2.55])
    )
    detector_to_cor_mm: PositiveMm = field(
        metadata=described(
            "r_D, detector to centre of rotation, mm; the source is on the other side.", examples=[714.7]
        )
    )
    source_shift_mm: CoordinateMm = field(metadata=_THETA["source_shift_mm"])
    detector_shift_mm: CoordinateMm = field(metadata=_THETA["detector_shift_mm"])
    detector_tilt: Slope = field(metadata=_THETA["detector_tilt"])

    @model_validator(mode="before")
    @classmethod
    def _of_stored(cls, stored: object) -> object:
        return vars(stored) if isinstance(stored, Theta) else stored


@dataclass(frozen=True)
class ReportedSourceFrame(SourceFrame):
    """The geometry with the source on the axis, what the data can see, with its magnification."""

    magnification = computed_field(description="SDD / R, no unit.", examples=[1.766])(SourceFrame.magnification)

    @model_validator(mode="before")
    @classmethod
    def _of_five(cls, stored: object) -> object:
        """Select the five numbers; the magnification, which a stored answer carries, follows from them."""
        fields = vars(stored) if isinstance(stored, SourceFrame) else stored
        if not isinstance(fields, dict):
            return fields
        return {name: value for name, value in fields.items() if name != "magnification"}


class ThetaDeviation(Contract):
    """Standard deviations of theta; null where the source shift is not resolved."""

    initial_angle_rad: float | None = Field(description="Standard deviation of alpha0, radians.", examples=[0.0001])
    detector_to_cor_mm: float | None = Field(description="Standard deviation of r_D, mm.", examples=[0.35])
    source_shift_mm: float | None = Field(description="Standard deviation of h_S, mm.", examples=[0.8])
    detector_shift_mm: float | None = Field(description="Standard deviation of h_D, mm.", examples=[0.1])
    detector_tilt: float | None = Field(
        description="Standard deviation of alpha_D, a slope without unit.", examples=[0.0002]
    )


class SourceFrameDeviation(Contract):
    """Standard deviations of the source frame; null for a parameter that the scan does not determine."""

    psi_rad: float | None = Field(description="Standard deviation of psi, radians.", examples=[0.0001])
    source_distance_mm: float | None = Field(description="Standard deviation of R, mm.", examples=[0.2])
    source_to_detector_mm: float | None = Field(description="Standard deviation of SDD, mm.", examples=[0.35])
    cor_column_mm: float | None = Field(description="Standard deviation of u_c, mm.", examples=[0.02])
    tilt_rad: float | None = Field(description="Standard deviation of tau, radians.", examples=[0.0002])
    magnification: float | None = Field(
        description="Standard deviation of the magnification, no unit.", examples=[0.0004]
    )


class SimulationOptions(Contract):
    """Options of a simulated scan, apart from body, scanner, geometry and physics."""

    views: Annotated[int, Field(ge=1, le=100_000)] = Field(360, description="Number of views.")
    rows: Annotated[int, Field(ge=1, le=100_000)] = Field(1, description="Number of rows of the stack.")
    noise: Annotated[float, Field(ge=0, le=100)] = Field(
        0.0, description="Standard deviation of the line integrals' noise, relative to their RMS."
    )
    background: Annotated[float, Field(ge=-LARGEST_MM, le=LARGEST_MM)] = Field(
        0.0, description="Constant that is added to all line integrals."
    )
    photons: Annotated[float, Field(ge=1, le=1e9)] = Field(
        30_000.0, description="Number of photons in air, a cell and view, for counts."
    )
    seed: Annotated[int, Field(ge=0, lt=2**32)] = Field(
        1, description="Seed of the log's and all noise's random numbers."
    )
