"""The sources of a calibration's uncertainty, after the Guide to the Expression of Uncertainty in Measurement (GUM)."""

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import Literal, Self

from sawmill_vocabulary.messages import N_

# A: evaluated from the scan's own scatter. B: from other knowledge.
UncertaintyKind = Literal["A", "B"]
# Where a source counts: its variance adds up with others; in the bound alone, by draws; in neither.
CountedIn = Literal["sum", "bound", "neither"]
LINE_INTEGRAL = N_("line integral")


class UncertaintySource(StrEnum):
    """A source of uncertainty: a line of the budget."""

    kind: UncertaintyKind
    counted_in: CountedIn
    unit: str  # of the source's standard uncertainty
    label: str

    def __new__(cls, code: str, kind: UncertaintyKind, counted_in: CountedIn, unit: str, label: str) -> Self:
        """Make a member whose value is the code."""
        member = str.__new__(cls, code)
        member._value_ = code
        member.kind, member.counted_in, member.unit, member.label = kind, counted_in, unit, label
        return member

    NOISE = "noise", "A", "sum", LINE_INTEGRAL, N_("noise of the samples")
    FLAT_FIELD = "flat-field", "A", "sum", LINE_INTEGRAL, N_("stripes of the flat field")
    AIR_LEVELS = "air-levels", "A", "sum", LINE_INTEGRAL, N_("offsets of views")
    VIEW_ANGLES = "view-angles", "A", "sum", "°", N_("scatter of the view angles")
    VIEW_POSES = "view-poses", "A", "sum", "mm", N_("poses of the views")
    WOOD_DENSITY = "wood-density", "A", "sum", "%", N_("density of the wood from patch to patch")
    EFFECT_SIZES = "effect-sizes", "A", "sum", "", N_("sizes of fitted effects")
    WITHIN_VIEWS = "within-views", "A", "sum", LINE_INTEGRAL, N_("misfit within views")
    BETWEEN_VIEWS = "between-views", "A", "sum", LINE_INTEGRAL, N_("misfit from view to view")
    DECLINED = "effects-switched-off", "A", "sum", "", N_("effects that are switched off")
    CELL_PLACES = "cell-places", "A", "sum", "mm", N_("places of cells beyond the fitted waves")
    HELD_DISTANCE = "held-source-distance", "B", "sum", "mm", N_("source held at the stated distance")
    LOG = "log", "A", "sum", "mm", N_("the log beside the phantom")
    SIZE = "phantom-size", "B", "sum", "%", N_("the phantom's size")
    MODULES = "hidden-modules", "B", "bound", "", N_("modules that the scan may hide")
    EXPLANATIONS = "other-explanations", "B", "bound", "", N_("other motions that explain the scan")
    ASPECT = "aspect", "B", "bound", "%", N_("the phantom's aspect")
    MOISTURE = "moisture", "B", "neither", "%", N_("the phantom's moisture since it was measured")
    TEMPERATURE = "temperature", "B", "neither", "K", N_("the phantom's temperature since it was measured")
    PITCH = "detector-pitch", "B", "neither", "%", N_("the distance of the cells")
    SOURCE_DISTANCE = "source-to-cor", "B", "neither", "mm", N_("the stated distance of the source")


# Standard uncertainties where nobody states others, in the units of the sources.
STATED: Mapping[UncertaintySource, float] = MappingProxyType(
    {
        UncertaintySource.MOISTURE: 1.0,
        UncertaintySource.TEMPERATURE: 5.0,
        UncertaintySource.PITCH: 0.1,
        UncertaintySource.SOURCE_DISTANCE: 1.0,
    }
)
# Changes of length, %, of spruce and pine across the grain: for each per cent of moisture (docs/do/phantom.md), and for
# each kelvin (Wood Handbook, FPL-GTR-282, 2021, chapter 4).
MOISTURE_MOVES, TEMPERATURE_MOVES = 0.25, 0.003
