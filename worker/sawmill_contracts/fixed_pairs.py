"""Calibrations of scanners of fixed pairs: options, and the answer of the command and of Python."""

from pydantic import Field

from sawmill_contracts.calibrations import CalibrationLimits
from sawmill_contracts.choices import Verdict
from sawmill_contracts.geometry import ReportedSourceFrame, SourceFrameDeviation
from sawmill_contracts.reasons import CodedReason
from sawmill_platform.contracts.base import Contract
from sawmill_vocabulary import CellOrder, Handedness


class FixedPairsOptions(CalibrationLimits):
    """Options of a calibration of fixed pairs."""

    handedness: Handedness = Field(Handedness.AS_DRAWN, description="From which side the board is seen.")
    corner_tolerance_mm: float = Field(
        0.3,
        gt=0,
        le=10,
        description="Standard deviation of the drawing's corners, mm: how exactly the board was sawn or measured.",
    )


class CalibratedPair(Contract):
    """One pair in the common frame, which is the one that is nearest to all nominal places."""

    source_frame: ReportedSourceFrame = Field(
        description="The pair's geometry; psi_rad is the angle of its source about the centre."
    )
    standard_deviation: SourceFrameDeviation = Field(description="Standard deviations of the five numbers.")
    predicted_rms_mm: float = Field(description="Predicted error of this pair's rays, RMS, mm.")
    upper_95_mm: float = Field(description="The error of this pair's rays is below this with 95 %, mm.")
    cell_order: CellOrder = Field(description="Which way the cells count about the centre.")
    order_deviations: float | None = Field(
        description="By how many standard deviations the other order is worse; null: the order was stated."
    )


class BoardPose(Contract):
    """How the board lay in a passage, at the middle of the rows."""

    x_mm: float = Field(description="Middle of the board, mm.")
    y_mm: float = Field(description="Middle of the board, mm.")
    roll_deg: float = Field(description="Turn of the board against its drawing, counter-clockwise, degrees.")


class FixedPairsResult(Contract):
    """The calibration of a scanner of fixed pairs."""

    verdict: Verdict = Field(description="pass, watch or fail.")
    reasons: list[str] = Field(description="Reasons in English sentences, the worst first.")
    coded_reasons: list[CodedReason] = Field(description="The reasons for programs.")
    predicted_rms_mm: float = Field(
        description="Predicted error of all rays, RMS, mm, after the common rigid motion and scale."
    )
    upper_95_mm: float = Field(description="The error of the rays is below this with 95 %, mm.")
    scale_uncertainty_percent: float = Field(description="Sizes may be wrong by this, 95 %; the board is the ruler.")
    pairs: list[CalibratedPair] = Field(description="The pairs, in the order of the scanner's.")
    passages: list[BoardPose] = Field(description="The board in each passage.")
    rows: list[tuple[int, int]] = Field(description="Rows of each pair that show the board: first, after the last.")
    corners_rms_mm: float = Field(description="By how much the drawing's corners were found to be off, RMS, mm.")
    residual_percent: float = Field(description="RMS of what the fit leaves, as a share of the shadow's RMS.")
    outline_mm: list[list[tuple[float, float]]] = Field(
        description="Outlines of the board about its middle, from the side that is seen, as drawn."
    )
    log_radius_mm: float = Field(description="Radius of the disc in which ray errors count, mm.")
    phantom: str = Field(description="Name of the drawing.")
    options: FixedPairsOptions = Field(description="The options.")
