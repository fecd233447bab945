"""Sources and lines of an uncertainty budget, after the Guide to the Expression of Uncertainty in Measurement (GUM)."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from sawmill_vocabulary.messages import N_
from sawmill_vocabulary.outlines import AsContract

Kind = Literal["A", "B"]
CountedIn = Literal["sum", "bound", "neither"]
States = Literal["standard-deviation", "allowance", "limit"]  # which is which: benchmarks/budget.py


class UncertaintySource(NamedTuple):
    """A source of uncertainty."""

    kind: Kind
    counted_in: CountedIn
    unit: str  # 1: of a line integral
    label: str
    assumed: float = 0.0  # standard uncertainty where an answer has none
    scale_by_unit: float = 0.0  # sensitivity of the image's millimetres, per cent
    highest: float = math.inf  # above this value the source changes nothing more
    states: States = "standard-deviation"


# Spruce and pine move across the grain by 0.25 % for each per cent of moisture (docs/do/phantom.md) up to the fibres'
# saturation at 30 %, and by 0.003 % for each kelvin (Wood Handbook, FPL-GTR-282, 2021, chapter 4).
SOURCES: Mapping[str, UncertaintySource] = {
    "noise": UncertaintySource("A", "sum", "1", N_("noise of the samples")),
    "scatter": UncertaintySource("A", "sum", "1", N_("fitted scatter: flat field, view angles, densities, effects")),
    "misfit-within-views": UncertaintySource("A", "sum", "1", N_("misfit within views"), states="allowance"),
    "misfit-between-views": UncertaintySource("A", "sum", "1", N_("misfit from view to view"), states="allowance"),
    "view-poses": UncertaintySource("A", "sum", "mm", N_("geometry and poses of the views together")),
    "effects-switched-off": UncertaintySource("A", "sum", "", N_("effects that are switched off")),
    "cell-places": UncertaintySource("A", "sum", "mm", N_("places of cells beyond fitted waves"), states="allowance"),
    "log": UncertaintySource("A", "sum", "mm", N_("the log beside the phantom"), states="allowance"),
    "held-source-distance": UncertaintySource("B", "sum", "mm", N_("R held at the stated source distance")),
    "phantom-size": UncertaintySource("B", "sum", "%", N_("the phantom's size")),
    "other-motions": UncertaintySource("B", "bound", "", N_("other motions that explain the scan"), states="allowance"),
    "hidden-modules": UncertaintySource("B", "bound", "", N_("modules that the scan may hide")),
    "found-modules": UncertaintySource("B", "bound", "", N_("modules' places, and hidden ones"), states="allowance"),
    "aspect": UncertaintySource("B", "bound", "%", N_("the phantom's aspect"), states="limit"),
    "moisture": UncertaintySource("B", "neither", "%", N_("moisture since the phantom was measured"), 1.0, 0.25, 30.0),
    "temperature": UncertaintySource("B", "neither", "K", N_("temperature since the phantom was measured"), 5.0, 0.003),
    "cell-distance": UncertaintySource("B", "neither", "%", N_("distance of the cells"), 0.1),
    "source-distance": UncertaintySource("B", "neither", "mm", N_("stated source distance"), 1.0),
}


def _of(description: str, example: str | float) -> dict[str, object]:
    return {"description": description, "examples": [example]}


@dataclass(frozen=True)
class ContrastLoss(AsContract):
    """Mean losses of an image by rays that are off, over all places and directions in the log's disc."""

    knot_10_mm_percent: float = field(metadata=_of("Contrast that a knot of 10 mm loses, per cent.", 2.1))
    mtf_percent: float = field(metadata=_of("Loss of the MTF at 0.1 cycles per mm, per cent.", 5.7))

    @property
    def matters(self) -> bool:
        """True if a sentence states it: smaller losses are not compared by benchmarks/contrast_loss.py."""
        return self.knot_10_mm_percent >= 5.0


@dataclass(frozen=True)
class BudgetLine(AsContract):
    """A line of the uncertainty budget: a source, and what it does to the rays and to the image's millimetres."""

    source: str = field(metadata=_of("Source: docs/understand/verdict.md#the-uncertainty-budget.", "noise"))
    standard_uncertainty: float | None = field(
        metadata=_of("Standard uncertainty in `unit`; of misfit, of noise that does the same. Null: no one size.", 0.02)
    )
    rays_mm: float = field(metadata=_of("RMS ray error by the source, mm, a common scale taken out.", 0.015))
    rays_mm_per_unit: float | None = field(metadata=_of("Sensitivity of the rays, mm per unit. Null: as above.", 0.75))
    rays_share_percent: float | None = field(metadata=_of("Share in the rays' variance. Null: not in the sum.", 64.0))
    scale_percent: float = field(
        metadata=_of("Standard uncertainty of the image's scale, per cent; by the aspect the whole limit.", 0.01)
    )
    scale_share_percent: float | None = field(metadata=_of("Share in the scale's variance. Null: not in the sum.", 1.2))
    kind: Kind = field(metadata=_of("A: from the scan's own scatter. B: from other knowledge.", "A"))
    counted_in: CountedIn = field(
        metadata=_of("sum: variances add up. bound: in the 95 % bound alone. neither: in no other number.", "sum")
    )
    unit: str = field(metadata=_of("Unit of the source; 1: of a line integral.", "1"))
    states: States = field(default="standard-deviation", metadata=_of("allowance: scans mostly scatter less.", "limit"))
    change: float | None = field(default=None, metadata=_of("Stated change in `unit`, a part of the uncertainty.", 3.0))
