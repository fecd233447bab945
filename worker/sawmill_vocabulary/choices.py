"""Choices in requests and answers, the enums and literals of both sides, and the progress of a running job."""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal, Protocol, Self, TypeVar

from sawmill_vocabulary.messages import N_
from sawmill_vocabulary.outlines import described


class _Negatable(Protocol):
    def __neg__(self) -> Self: ...


_Angles = TypeVar("_Angles", bound=_Negatable)


class Handedness(StrEnum):
    """Handedness, from which end the phantom was seen: as drawn, or from behind (y becomes -y)."""

    AS_DRAWN = "as-drawn"
    FROM_BEHIND = "from-behind"


class CellOrder(StrEnum):
    """Order of a fixed detector's cells: which way they count about the scanner's centre."""

    COUNTER_CLOCKWISE = "counter-clockwise"
    CLOCKWISE = "clockwise"


class Rotation(StrEnum):
    """Sense of rotation: view angles count as the scan gives them, or the other way (phi becomes -phi)."""

    AS_GIVEN = "as-given"
    REVERSED = "reversed"

    def apply(self, angles_rad: _Angles) -> _Angles:
        """Return view angles in this sense of rotation; a float or an array."""
        return angles_rad if self is Rotation.AS_GIVEN else -angles_rad


class DataKind(StrEnum):
    """Kind of the numbers of a scan. Never guessed."""

    COUNTS = "counts"
    LINE_INTEGRALS = "line-integrals"


class AirCorrection(StrEnum):
    """Correction of the line integrals by the air at the detector's ends.

    `background` is one constant for a row. `views` is each view's level where it drifts, else the constant. `auto` is
    `views` for counts and `off` for line integrals.
    """

    AUTO = "auto"
    OFF = "off"
    BACKGROUND = "background"
    VIEWS = "views"


class FaultyCells(StrEnum):
    """Treatment of dead and hot detector cells."""

    AUTO = "auto"
    KEEP = "keep"
    BRIDGE = "bridge"


class RingRemoval(StrEnum):
    """Method of removing rings."""

    OFF = "off"
    SORTING = "sorting"


class RowAlignment(StrEnum):
    """Alignment along the log of views that lost rows."""

    OFF = "off"
    PROFILE = "profile"
    FEATURES = "features"


class CalibrationMethod(StrEnum):
    """Search of a calibration: `default` is the product's, `paper` is the published one."""

    DEFAULT = "default"
    PAPER = "paper"


class Adjustment(StrEnum):
    """Adjustment that a calibration makes to a scan that the plain model does not fit; each can be left out."""

    FAULTY_CELLS = "faulty-cells"
    CORRUPT_VIEWS = "corrupt-views"
    METAL = "metal"
    INTENSITY_AVERAGING = "intensity-averaging"
    BLUR = "blur"
    OUTLIERS = "outliers"
    VIEW_GAIN = "view-gain"
    BEAM_HARDENING = "beam-hardening"
    DENSITY_GRADIENT = "density-gradient"
    SCATTERED_RADIATION = "scattered-radiation"
    LAG = "lag"
    ROTATION_DURING_EXPOSURE = "rotation-during-exposure"
    FLAT_FIELD = "flat-field"
    MODULES = "modules"
    CELL_PLACES = "cell-places"
    DEFORMATION = "deformation"
    BOW = "bow"
    SURFACE_DENSITY = "surface-density"
    WOOD_DENSITY = "wood-density"
    CORNERS = "corners"
    PACE = "pace"
    CREEP = "creep"
    SLIP = "slip"
    ENCODER = "encoder"
    WOBBLE = "wobble"
    ANGLE_JITTER = "angle-jitter"
    VIEW_POSES = "view-poses"
    PHANTOM_ROWS = "phantom-rows"


class CalibrationStatus(StrEnum):
    """Status of an answer, how far it may be relied on; `reasons` hold the cure."""

    CALIBRATED = "calibrated"
    IMPRECISE = "imprecise"
    AMBIGUOUS_TURN = "ambiguous-turn"
    AMBIGUOUS_HANDEDNESS = "ambiguous-handedness"
    INCONSISTENT_SCALE = "inconsistent-scale"
    NOT_CONVERGED = "not-converged"
    WITHOUT_ERROR_BARS = "without-error-bars"


Verdict = Literal["pass", "watch", "fail"]


class Agreement(StrEnum):
    """Agreement of the phantom and the log next to it in u_c and tilt: within 95 %, within 99.9 %, or not."""

    AGREE = "agree"
    STRAINED = "strained"
    DISAGREE = "disagree"


class MovedBody(StrEnum):
    """Body that alone moved during a scan, or both."""

    PHANTOM = "phantom"
    LOG = "log"
    BOTH = "both"


# Source of the reported u_c and tilt.
UsedEstimate = Literal["both", "log", "phantom"]

# Objective of the published search (arXiv 2206.14444).
PaperObjective = Literal["image", "projection"]
PaperCorrelation = Literal["unnormalised", "normalised"]
PaperStop = Literal["published", "tight"]


class ReconstructionMethod(StrEnum):
    """Filtered back-projection, the iterative methods, or the choice by the scan's views and noise."""

    # One line for each method: its name, its name on pages, and when to use it.
    FBP = "fbp", N_("Filtered back-projection"), N_("The fastest, for scans with many views all round.")
    TIKHONOV = "tikhonov", N_("Tikhonov"), N_("A smooth picture, to compare the others with.")
    CAUCHY_MAP = "cauchy_map", N_("Cauchy MAP"), N_("Keeps edges from as few as 20 views; takes the longest.")
    TOTAL_VARIATION = (
        *("total_variation", N_("Total variation")),
        N_("Sharp edges and little noise, also from few views; takes longer."),
    )
    RING_TV = (
        *("ring_tv", N_("Ring-aware total variation")),
        N_("As total variation, and keeps growth rings from few views."),
    )
    AUTO = "auto", N_("Automatic"), N_("Takes the method that suits the scan's number of views and its noise.")

    label: str
    advice: str

    def __new__(cls, name: str, *texts: str) -> Self:
        """Make a word that carries the texts of the pages."""
        method = str.__new__(cls, name)
        method._value_ = name
        method.label, method.advice = texts
        return method


class ObjectTurns(StrEnum):
    """When the object turns: in one scan, or between passages, one for each view, in which its pose differs."""

    IN_ONE_SCAN = "in-one-scan"
    BETWEEN_PASSAGES = "between-passages"


class PoseHandling(StrEnum):
    """Treatment of the poses of a log's views.

    `auto` finds them where the scanner's object turns between passages. `from-log` finds them. `none` takes the log to
    stand still.
    """

    AUTO = "auto"
    FROM_LOG = "from-log"
    NONE = "none"


class HardeningHandling(StrEnum):
    """Treatment of hardening and scatter that a calibration found: `auto` takes both out, `none` neither."""

    AUTO = "auto"
    NONE = "none"


class MetalHandling(StrEnum):
    """Treatment of rays through metal in a log.

    `auto` leaves the rays out where a method can do without, and interpolates them for other methods. `interpolate`
    interpolates them for every method. `none` takes them as they are.
    """

    AUTO = "auto"
    INTERPOLATE = "interpolate"
    NONE = "none"


class Preference(StrEnum):
    """Preference of `auto`.

    quality: the lowest expected error within a price in time. speed: filtered back-projection wherever views suffice.
    """

    QUALITY = "quality"
    SPEED = "speed"


class FilterName(StrEnum):
    """Window on the ramp."""

    RAM_LAK = "ram-lak"
    SHEPP_LOGAN = "shepp-logan"
    COSINE = "cosine"
    HAMMING = "hamming"
    HANN = "hann"


# `none` is the published pipeline's: no cosine weight, no distance weight.
Weighting = Literal["exact", "none"]


class AlphaRule(StrEnum):
    """Rule by which Tikhonov's alpha is chosen where it is not given.

    cross-validation: the alpha whose image predicts views that were left out best (Stone 1974). discrepancy: the
    largest alpha that explains the data to their noise (Morozov). gcv: generalised cross-validation (Golub, Heath
    and Wahba 1979). l-curve: where residual against norm bends most sharply (Hansen 1992).
    """

    CROSS_VALIDATION = "cross-validation"
    DISCREPANCY = "discrepancy"
    GCV = "gcv"
    L_CURVE = "l-curve"


class ColorMap(StrEnum):
    """Colours of values in a picture, from low to high."""

    GREY = "grey"
    VIRIDIS = "viridis"
    INFERNO = "inferno"
    MAGMA = "magma"


@dataclass(frozen=True)
class Progress:
    """Progress of a running job."""

    fraction: float = field(metadata=described("Share of the work that is done, no unit.", ge=0, le=1, examples=[0.4]))
    stage: str = field(metadata=described("Present stage of the work.", examples=["search"]))
    generation: int | None = field(
        default=None,
        metadata=described("Number of the search's generation. Null: no search is running.", examples=[12]),
    )
    best_value: float | None = field(
        default=None,
        metadata=described(
            "Best objective of the search, in the objective's own unit. Null: no search is running.", examples=[0.013]
        ),
    )
    seconds_left: float | None = field(
        default=None,
        metadata=described("Seconds until a reconstruction ends, by its pace. Null: not known.", ge=0, examples=[40.0]),
    )


ProgressCallback = Callable[[Progress], None]
