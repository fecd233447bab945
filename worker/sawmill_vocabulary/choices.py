"""What can be chosen and what can be answered: the enums and literals of both sides."""

from enum import StrEnum
from typing import Literal, Protocol, Self, TypeVar

from sawmill_vocabulary.texts import N_


class _Negatable(Protocol):
    def __neg__(self) -> Self: ...


_Angles = TypeVar("_Angles", bound=_Negatable)


class Handedness(StrEnum):
    """From which end the phantom was looked at: as drawn, or from behind (y becomes -y)."""

    AS_DRAWN = "as-drawn"
    FROM_BEHIND = "from-behind"


class Rotation(StrEnum):
    """Which way the view angles count: as the scan gives them, or the other way (phi becomes -phi)."""

    AS_GIVEN = "as-given"
    REVERSED = "reversed"

    def apply(self, angles_rad: _Angles) -> _Angles:
        """View angles as this sense of rotation reads them; a float or an array."""
        return angles_rad if self is Rotation.AS_GIVEN else -angles_rad


class DataKind(StrEnum):
    """What the numbers of a scan are. Never guessed."""

    COUNTS = "counts"
    LINE_INTEGRALS = "line-integrals"


class AirCorrection(StrEnum):
    """What the air at the detector's ends takes out of the line integrals.

    `background` is one constant for a row. `views` is each view's level where it drifts, else the constant. `auto` is
    `views` for counts and `off` for line integrals.
    """

    AUTO = "auto"
    OFF = "off"
    BACKGROUND = "background"
    VIEWS = "views"


class FaultyCells(StrEnum):
    """What becomes of dead and hot detector cells."""

    AUTO = "auto"
    KEEP = "keep"
    BRIDGE = "bridge"


class RingRemoval(StrEnum):
    """How rings are taken out."""

    OFF = "off"
    SORTING = "sorting"


class RowAlignment(StrEnum):
    """How views that lost rows are aligned along the log."""

    OFF = "off"
    PROFILE = "profile"
    FEATURES = "features"


class CalibrationMethod(StrEnum):
    """`default` is what users want; `paper` is the published search."""

    DEFAULT = "default"
    PAPER = "paper"


class Adjustment(StrEnum):
    """What a calibration does by itself about a scan that is not as the plain model has it; each can be left out."""

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
    DEFORMATION = "deformation"
    CORNERS = "corners"
    PACE = "pace"
    CREEP = "creep"
    SLIP = "slip"
    ENCODER = "encoder"
    WOBBLE = "wobble"
    ANGLE_JITTER = "angle-jitter"
    PHANTOM_ROWS = "phantom-rows"


class CalibrationStatus(StrEnum):
    """How far an answer may be relied on; `reasons` hold the cure."""

    CALIBRATED = "calibrated"
    IMPRECISE = "imprecise"
    AMBIGUOUS_TURN = "ambiguous-turn"
    AMBIGUOUS_HANDEDNESS = "ambiguous-handedness"
    INCONSISTENT_SCALE = "inconsistent-scale"
    NOT_CONVERGED = "not-converged"
    WITHOUT_ERROR_BARS = "without-error-bars"


Verdict = Literal["pass", "watch", "fail"]


class Agreement(StrEnum):
    """Whether the phantom and the log beside it give the same u_c and tilt: within 95 %, within 99.9 %, or not."""

    AGREE = "agree"
    STRAINED = "strained"
    DISAGREE = "disagree"


class MovedBody(StrEnum):
    """What moved alone during a scan, or that both did."""

    PHANTOM = "phantom"
    LOG = "log"
    BOTH = "both"


# Whose u_c and tilt are reported.
WitnessTaken = Literal["both", "log", "phantom"]

# Of the published search (arXiv 2206.14444).
PaperObjective = Literal["image", "projection"]
PaperCorrelation = Literal["unnormalised", "normalised"]
PaperStop = Literal["published", "tight"]


class ReconstructionMethod(StrEnum):
    """Filtered back-projection, the iterative methods, or whichever of them suits the scan's views and noise."""

    # A line a method: its name, what pages call it, and when to use it.
    FBP = "fbp", N_("Filtered back-projection"), N_("The fastest, for scans with many views all round.")
    TIKHONOV = "tikhonov", N_("Tikhonov"), N_("A smooth picture, to compare the others with.")
    CAUCHY_MAP = "cauchy_map", N_("Cauchy MAP"), N_("Keeps edges from as few as 20 views; takes the longest.")
    TOTAL_VARIATION = (
        *("total_variation", N_("Total variation")),
        N_("Sharp edges and little noise, also from few views; takes longer."),
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


class HardeningHandling(StrEnum):
    """What becomes of hardening and scatter that a calibration found: `auto` takes them out, `none` neither."""

    AUTO = "auto"
    NONE = "none"


class MetalHandling(StrEnum):
    """What becomes of rays through metal in a log.

    `auto` leaves them out where a method can do without rays, and interpolates them for the others. `interpolate` does
    so for every method. `none` takes them as they are.
    """

    AUTO = "auto"
    INTERPOLATE = "interpolate"
    NONE = "none"


class Preference(StrEnum):
    """What `auto` goes by.

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
    """How Tikhonov's alpha is chosen where it is not given.

    cross-validation: the alpha whose image predicts views that were left out best (Stone 1974). discrepancy: the
    largest alpha that explains the data to their noise (Morozov). gcv: generalised cross-validation (Golub, Heath
    and Wahba 1979). l-curve: where residual against norm bends most sharply (Hansen 1992).
    """

    CROSS_VALIDATION = "cross-validation"
    DISCREPANCY = "discrepancy"
    GCV = "gcv"
    L_CURVE = "l-curve"


class ColorMap(StrEnum):
    """How a picture shows values, from low to high."""

    GREY = "grey"
    VIRIDIS = "viridis"
    INFERNO = "inferno"
    MAGMA = "magma"
