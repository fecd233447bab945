"""The one shape of an effect that may be fitted beside the geometry: its columns, and what is reported of it."""

from collections.abc import Callable
from dataclasses import dataclass

from sawmill_tomography.calibration.normal_equations import Column
from sawmill_tomography.calibration.scan_model import ScanModel, Term
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment


@dataclass(frozen=True)
class Effect:
    """What a scan may be beyond the plain model.

    Attributes
    ----------
    adjustment : Adjustment
        What switches it off.
    columns : callable
        Its unknowns for a model; none where such a scan cannot show it.
    sentence : callable
        What is reported of it, from the model that has it and the sizes of its columns.
    remedy : str
        What to do about it, where something should be done.
    """

    adjustment: Adjustment
    columns: Callable[[ScanModel], tuple[Column, ...]]
    sentence: Callable[[ScanModel, FloatArray], str]
    remedy: str = ""


def terms(*chosen: Term, counts: bool = False) -> Callable[[ScanModel], tuple[Column, ...]]:
    """One column a term; none where intensities are needed (`counts`) and the scan has none."""

    def columns(model: ScanModel) -> tuple[Column, ...]:
        if counts and not model.from_counts:
            return ()
        return tuple(Column.of(term) for term in chosen)

    return columns
