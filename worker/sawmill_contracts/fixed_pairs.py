"""Calibrations of scanners of fixed pairs: requests, and the answer of the service, the command and Python."""

from typing import Self

from pydantic import Field, model_validator

from sawmill_contracts import kinds
from sawmill_contracts.calibrations import CalibrationLimits
from sawmill_contracts.choices import Verdict
from sawmill_contracts.geometry import ReportedSourceFrame, SourceFrameDeviation
from sawmill_contracts.kinds import AskedKind, JobAnswer, JobLinks, Operation, Reference, stored_as
from sawmill_contracts.reasons import CodedReason
from sawmill_platform.contracts.base import Contract, Identifier, link
from sawmill_platform.contracts.given import Given
from sawmill_vocabulary import CellOrder, DataKind, FixedPair, Handedness
from sawmill_vocabulary.messages import N_
from sawmill_vocabulary.pairs import FEWEST_PAIRS, MOST_PAIRS

# More of them add little: the board's drawing limits what they show (docs/evidence/accuracy.md).
MOST_PASSAGES = 12


class FixedPairsOptions(CalibrationLimits):
    """Options of a calibration of fixed pairs."""

    handedness: Handedness = Field(Handedness.AS_DRAWN, description="Side from which the board is seen.")
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
        description="Number of standard deviations by which the other order is worse. Null: the order was stated."
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
    corners_rms_mm: float = Field(description="Error of the drawing's corners that was found, RMS, mm.")
    residual_percent: float = Field(description="RMS of what the fit leaves, as a share of the shadow's RMS.")
    outline_mm: list[list[tuple[float, float]]] = Field(
        description="Outlines of the board about its middle, mm, from the side that is seen, as drawn."
    )
    log_radius_mm: float = Field(description="Radius of the disc in which ray errors count, mm.")
    phantom: str = Field(description="Name of the drawing.")
    options: FixedPairsOptions = Field(description="The options.")


class StoredFixedPairsOptions(FixedPairsOptions):
    """Options of a calibration of fixed pairs, with the nominal places and the files."""

    pairs: list[FixedPair] = Field(
        min_length=FEWEST_PAIRS, max_length=MOST_PAIRS, description="The nominal places of the pairs."
    )
    inspection_ids: list[Identifier] = Field(
        min_length=FEWEST_PAIRS,
        max_length=MOST_PAIRS * MOST_PASSAGES,
        description="Ids of the inspections that received the files: one for each pair, in the order of `pairs`, whose "
        "views are the passages and whose rows run along the feed. Passages that were recorded apart have such files "
        "each, one passage after the other.",
        examples=[["example-pair-1", "example-pair-2"]],
    )
    data: DataKind = Field(description="Kind of the numbers in all files; never guessed.", examples=["counts"])


class FixedPairsRequest(StoredFixedPairsOptions, Given):
    """Request to calibrate a scanner of fixed pairs from passages of one board."""

    phantom_id: Identifier = Field(description="Id of the phantom, which is the board.", examples=["l-shape"])

    @model_validator(mode="after")
    def _has_files_for_all_pairs(self) -> Self:
        if len(self.inspection_ids) % len(self.pairs):
            raise ValueError(
                f"inspection_ids has {len(self.inspection_ids)} files for {len(self.pairs)} pairs: give one for each "
                "pair, passage by passage"
            )
        return self


class FixedPairsLinks(JobLinks):
    """Links to related resources."""

    ring: str = link("the drawing", "fixed-pairs/example/ring.png")
    phantom: str = link("the phantom", "phantoms/l-shape")


class FixedPairs(JobAnswer[StoredFixedPairsOptions, FixedPairsResult, FixedPairsLinks]):
    """A calibration of fixed pairs in its present state."""

    phantom_id: Identifier = Field(description="Id of the phantom.", examples=["l-shape"])


_PLACE = {"source_distance_mm": 860, "source_to_detector_mm": 1570, "num_detector_pixels": 192}
DECLARATION = AskedKind(
    kind=kinds.CALIBRATE_PAIRS,
    noun="fixed-pairs",
    label=N_("Calibration of fixed pairs"),
    about="Calibrations of scanners of two to six fixed pairs of source and detector, through which the log slides.",
    lighter="give files with fewer rows",
    ask=FixedPairsRequest,
    options=StoredFixedPairsOptions,
    result=FixedPairsResult,
    answer=FixedPairs,
    read=stored_as(FixedPairs),
    links=FixedPairsLinks,
    files={"ring": "ring.png"},
    references=(Reference.INSPECTION, Reference.PHANTOM),
    is_short=lambda _: True,
    blocks_deletion=False,
    listed_by=("phantom_id", "state"),
    to_ask=Operation(
        "Calibrate a scanner of fixed pairs",
        """\
Find the places of all pairs from one to three passages of a board, by nominal places of a tape.

Send each file to `POST /v1/inspections` first. After one passage the verdict is often `watch`: roll the board by about
a quarter, pass it again, and ask with the files of both passages.""",
        {
            "body": {
                "pairs": [
                    {"angle_deg": angle, **_PLACE, "detector_pitch_mm": 4.8, "cell_order": "clockwise"}
                    for angle in (0, 90)
                ],
                "inspection_ids": ["example-pair-1", "example-pair-2"],
                "phantom_id": "l-shape",
                "data": "counts",
            }
        },
    ),
    to_list=Operation(
        "List calibrations of fixed pairs, newest first", "All of them, or a selection by phantom or state."
    ),
    to_get=Operation(
        "Get a calibration of fixed pairs",
        "State of the job, and once it has succeeded the places and their errors.",
        {"fixed_pairs_id": "example-pairs"},
    ),
)
