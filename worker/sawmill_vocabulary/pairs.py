"""Scanners of several fixed pairs of source and detector, through which the object slides lengthwise.

Axes, signs and formulas: docs/look-up/conventions.md#pairs.
"""

import math
from dataclasses import dataclass, field, fields, replace
from typing import Literal, Self

from sawmill_vocabulary.choices import CellOrder
from sawmill_vocabulary.geometry import LARGEST_MM, TAU, DetectorModule, GeometryError, Scanner, SourceFrame
from sawmill_vocabulary.outlines import AsContract, described

FEWEST_PAIRS, MOST_PAIRS = 2, 6
_CELLS = {one.name: one.metadata for one in fields(Scanner)}


def _length(description: str, *, low: float = -LARGEST_MM, default: float = 0.0) -> float:
    return field(default=default, metadata=described(description, ge=low, le=LARGEST_MM))


@dataclass(frozen=True)
class FixedPair(AsContract):
    """A fixed pair of source and line detector: the nominal place, and how far the true place may be from it."""

    angle_deg: float = field(
        metadata=described(
            "Angle of the source about the scanner's centre, counter-clockwise from -y, degrees.",
            ge=-360,
            le=360,
            examples=[90.0],
        )
    )
    source_distance_mm: float = field(
        metadata=described("Source to centre, mm.", gt=0, le=LARGEST_MM, examples=[860.0])
    )
    source_to_detector_mm: float = field(
        metadata=described(
            "Source to detector along the ray through the centre, mm.", gt=0, le=LARGEST_MM, examples=[1570.0]
        )
    )
    num_detector_pixels: int = field(metadata=_CELLS["num_detector_pixels"])
    detector_pitch_mm: float = field(metadata=_CELLS["detector_pitch_mm"])
    cor_column_mm: float = _length("Point of the detector that the ray through the centre meets, mm from its middle.")
    detector_tilt_deg: float = field(
        default=0.0,
        metadata=described(
            "Tilt of the detector against the normal of the ray through the centre, degrees.", gt=-80, lt=80
        ),
    )
    detector_modules: tuple[DetectorModule, ...] = field(
        default=(),
        metadata={
            **_CELLS["detector_modules"],
            "description": "Modules of the line detector after the first; a calibration takes them as stated.",
        },
    )
    detector_arc_radius_mm: float | None = field(default=None, metadata=_CELLS["detector_arc_radius_mm"])
    feed_offset_mm: float = _length(
        "Place of the pair's plane along the feed, mm: its rows show the object at heights larger by this."
    )
    cell_order: CellOrder | None = field(
        default=None,
        metadata=described(
            "Whether the cells count counter-clockwise about the centre, seen as the angles are; null: "
            "not known, the calibration finds it."
        ),
    )
    angle_within_deg: float = field(
        default=10.0, metadata=described("How far angle and tilt may be from the nominal ones, degrees.", gt=0, le=90)
    )
    place_within_mm: float = field(
        default=60.0,
        metadata=described(
            "How far distances and the detector's middle may be from the nominal ones, mm.", gt=0, le=LARGEST_MM
        ),
    )

    def __post_init__(self) -> None:
        """Refuse cells that no detector has, and a detector in front of the centre."""
        self.scanner  # noqa: B018 - refuses what no scanner has
        if not self.source_to_detector_mm > self.source_distance_mm > 0.0:
            raise GeometryError(
                f"source_to_detector_mm {self.source_to_detector_mm:g} must be larger than source_distance_mm "
                f"{self.source_distance_mm:g}: the centre lies between source and detector"
            )

    @property
    def scanner(self) -> Scanner:
        """The constants of a scanner with this pair alone."""
        return Scanner(
            self.source_distance_mm,
            self.num_detector_pixels,
            self.detector_pitch_mm,
            self.detector_modules,
            self.detector_arc_radius_mm,
        )

    def at(self, frame: SourceFrame) -> Self:
        """Return the pair with this nominal place."""
        return replace(
            self,
            angle_deg=math.degrees(math.remainder(frame.psi_rad, TAU)),
            source_distance_mm=frame.source_distance_mm,
            source_to_detector_mm=frame.source_to_detector_mm,
            cor_column_mm=frame.cor_column_mm,
            detector_tilt_deg=math.degrees(frame.tilt_rad),
        )

    @property
    def frame(self) -> SourceFrame:
        """The nominal place as a source frame, whose psi is the source's angle."""
        return SourceFrame(
            math.radians(self.angle_deg),
            self.source_distance_mm,
            self.source_to_detector_mm,
            self.cor_column_mm,
            math.radians(self.detector_tilt_deg),
        )


@dataclass(frozen=True)
class PairedScanner(AsContract):
    """A scanner of several fixed pairs."""

    pairs: tuple[FixedPair, ...] = field(
        metadata=described("The pairs, in the order of the scan's.", min_length=FEWEST_PAIRS, max_length=MOST_PAIRS)
    )

    def __post_init__(self) -> None:
        """Refuse one pair, which is a scanner that needs an object that turns."""
        if not FEWEST_PAIRS <= len(self.pairs) <= MOST_PAIRS:
            raise GeometryError(
                f"a scanner of fixed pairs has {FEWEST_PAIRS} to {MOST_PAIRS} pairs, not {len(self.pairs)}"
            )


@dataclass(frozen=True)
class LocatedMark(AsContract):
    """A nail, a stone or a dense knot."""

    place_mm: tuple[float, float, float] = field(
        metadata=described("x, y in the common frame, and height on the feed, mm.")
    )
    deviations_mm: tuple[float, float, float] = field(metadata=described("Their standard deviations, mm."))
    pairs: tuple[int, ...] = field(metadata=described("The pairs that show it, from 1."))
    residual_mm: float = field(metadata=described("RMS distance of the place from their rays, mm."))
    is_ambiguous: bool = field(metadata=described("Whether its marks fit other places too, which are listed."))


@dataclass(frozen=True)
class PairAgreement(AsContract):
    """Whether the rays of all pairs meet."""

    state: Literal["agree", "disagree", "unknown"] = field(
        metadata=described("`agree`, `disagree`, or `unknown`: this log shows neither.")
    )
    moved_mm: tuple[float, ...] = field(
        default=(), metadata=described("How far each pair's rays have moved if alone, mm.")
    )
    within_mm: tuple[float, ...] = field(default=(), metadata=described("Half of the 95 % interval of each, mm."))
    suspect: int | None = field(
        default=None, metadata=described("The pair, from 1, whose motion explains it far best. Null: none does.")
    )
