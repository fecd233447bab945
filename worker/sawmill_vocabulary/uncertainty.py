"""Sources and lines of an uncertainty budget, after the Guide to the Expression of Uncertainty in Measurement (GUM)."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal, Self

from sawmill_vocabulary.messages import N_
from sawmill_vocabulary.outlines import AsContract

CountedIn = Literal["sum", "bound", "neither"]


class UncertaintySource(StrEnum):
    """A source of uncertainty, with its kind, where it counts, its unit, and its name."""

    kind: Literal["A", "B"]
    counted_in: CountedIn
    unit: str  # 1: of a line integral
    label: str

    def __new__(cls, code: str, kind: Literal["A", "B"], counted_in: CountedIn, unit: str, label: str) -> Self:
        """Make a source whose value is its code."""
        source = str.__new__(cls, code)
        source._value_, source.kind, source.counted_in, source.unit, source.label = code, kind, counted_in, unit, label
        return source

    NOISE = "noise", "A", "sum", "1", N_("noise of the samples")
    SCATTER = "scatter", "A", "sum", "1", N_("scatter that is fitted: flat field, view angles, densities, effects")
    WITHIN_VIEWS = "within-views", "A", "sum", "1", N_("misfit within views")
    BETWEEN_VIEWS = "between-views", "A", "sum", "1", N_("misfit from view to view")
    VIEW_POSES = "view-poses", "A", "sum", "mm", N_("geometry and poses of the views together")
    DECLINED = "effects-switched-off", "A", "sum", "", N_("effects that are switched off")
    CELL_PLACES = "cell-places", "A", "sum", "mm", N_("places of cells beyond the fitted waves")
    LOG = "log", "A", "sum", "mm", N_("the log beside the phantom")
    HELD = "held-source-distance", "B", "sum", "mm", N_("R held at the stated source distance")
    SIZE = "phantom-size", "B", "sum", "%", N_("the phantom's size")
    EXPLANATIONS = "other-explanations", "B", "bound", "", N_("other motions that explain the scan")
    MODULES = "hidden-modules", "B", "bound", "", N_("modules that the scan may hide")
    ASPECT = "aspect", "B", "bound", "%", N_("the phantom's aspect")
    MOISTURE = "moisture", "B", "neither", "%", N_("moisture since the phantom was measured")
    TEMPERATURE = "temperature", "B", "neither", "K", N_("temperature since the phantom was measured")
    PITCH = "detector-pitch", "B", "neither", "%", N_("distance of the cells")
    SOURCE_DISTANCE = "source-to-cor", "B", "neither", "mm", N_("stated source distance")


# Standard uncertainties that are assumed where an answer has none.
ASSUMED = {
    UncertaintySource.MOISTURE: 1.0,
    UncertaintySource.TEMPERATURE: 5.0,
    UncertaintySource.PITCH: 0.1,
    UncertaintySource.SOURCE_DISTANCE: 1.0,
}
# Change of length, %, of spruce and pine across the grain for each per cent of moisture (docs/do/phantom.md), and for
# each kelvin (Wood Handbook, FPL-GTR-282, 2021, chapter 4).
BY_MOISTURE, BY_TEMPERATURE = 0.25, 0.003


def _of(description: str, example: str | float) -> dict[str, object]:
    return {"description": description, "examples": [example]}


@dataclass(frozen=True)
class BudgetLine(AsContract):
    """A line of the uncertainty budget: a source, and what it does to the rays and to the image's millimetres."""

    source: UncertaintySource = field(metadata=_of("Source of the uncertainty.", "noise"))
    standard_uncertainty: float | None = field(
        metadata=_of(
            "Standard uncertainty of the source in its unit; of scatter and misfit, of noise that does the same to the "
            "rays. Null: the source has no one size.",
            0.02,
        )
    )
    rays_mm: float = field(metadata=_of("RMS ray error by the source, mm, a common scale taken out.", 0.015))
    rays_mm_per_unit: float | None = field(metadata=_of("Sensitivity of the rays, mm per unit of the source.", 0.75))
    rays_share_percent: float | None = field(metadata=_of("Share in the rays' variance. Null: not in the sum.", 64.0))
    scale_percent: float = field(
        metadata=_of("Standard uncertainty of the image's scale, per cent; by the aspect the whole limit.", 0.01)
    )
    scale_share_percent: float | None = field(metadata=_of("Share in the scale's variance. Null: as above.", 1.2))
    kind: Literal["A", "B"] = field(metadata=_of("A: from the scan's own scatter. B: from other knowledge.", "A"))
    counted_in: CountedIn = field(
        metadata=_of("sum: variances add up. bound: in the 95 % bound alone. neither: in no other number.", "sum")
    )
    unit: str = field(metadata=_of("Unit of the source; 1: of a line integral.", "1"))
