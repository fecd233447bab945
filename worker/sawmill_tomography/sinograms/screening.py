"""Cells, views and samples without a usable signal, found before anything is fitted.

Such cells, views and samples get weight 0; for the search, cells and samples are bridged from their neighbours, and
views are left out.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.sinograms.air import faulty_cells
from sawmill_tomography.sinograms.present_rows import bridge, bridged_samples
from sawmill_vocabulary.scan_messages import AdjustmentMessage


@dataclass(frozen=True)
class Screening:
    """The usable parts of a sinogram."""

    cells: NDArray[np.bool_]  # (cells,) bool: usable cells
    views: NDArray[np.bool_]  # (views,) bool: usable views
    hidden: NDArray[np.bool_] | None = None  # (views, cells) bool or None

    @cached_property
    def weights(self) -> FloatArray | None:
        """Weights (views, cells) float64, 0 for samples that are not usable; None where all samples are usable."""
        if self.cells.all() and self.views.all() and self.hidden is None:
            return None
        weights = np.outer(self.views, self.cells).astype(np.float64)
        if self.hidden is not None:
            weights[self.hidden] = 0.0
        return weights

    @property
    def adjustments(self) -> tuple[str, ...]:
        """Sentences on cells and views that were left out."""
        sentences = []
        if not self.cells.all():
            sentences.append(AdjustmentMessage.CELLS_LEFT_OUT(cells=int((~self.cells).sum())))
        if not self.views.all():
            sentences.append(AdjustmentMessage.VIEWS_LEFT_OUT(views=int((~self.views).sum())))
        return tuple(sentences)

    def bridged(self, sinogram: FloatArray) -> FloatArray:
        """Interpolate cells and samples that are not usable along the detector."""
        if self.cells.all() and self.hidden is None:
            return sinogram
        filled = sinogram.copy()
        bridge(filled, ~self.cells)
        return filled if self.hidden is None else np.asarray(bridged_samples(filled, self.hidden), np.float64)


def screen(sinogram: FloatArray, *, cells: bool = True, views: bool = True) -> Screening:
    """Check the cells, the views, or both, of a sinogram (views, detector) before the sinogram is used."""
    kept_views = usable_views(sinogram) if views else np.ones(len(sinogram), bool)
    usable_cells = np.ones(sinogram.shape[1], bool)
    if cells:
        median = np.median(np.ascontiguousarray(sinogram[kept_views].T), axis=1)
        # A phantom has no structure of single cells, and loses little with a sound cell next to a hot cell.
        usable_cells = ~faulty_cells(sinogram[kept_views], median, recheck=False, most_faulty=1.0)
    if usable_cells.sum() < 8:
        usable_cells[:] = True
    return Screening(usable_cells, kept_views)


# A view is corrupt when this share of its samples is outside the range of the median view, or when its own range is
# less than this share of that range: a view that was never filled varies as the cells' gains do, by some 0.15.
VIEW_SHARE, FLAT_SHARE = 0.01, 0.05
# Fewer views cannot give the seven unknowns of a calibration, gain and background.
FEWEST_VIEWS = 3


def usable_views(sinogram: FloatArray) -> NDArray[np.bool_]:
    """Find the views (views,) of a sinogram (views, detector) that are not corrupt; all where hardly one is not."""
    # Hot cells occur in every view: the highest hundredth of the samples is left out for them.
    quantiles = np.quantile(sinogram, [0.02, 0.99], axis=1)
    low, high = np.median(quantiles, axis=1).tolist()
    span = high - low
    outside = ((sinogram < low - 0.3 * span) | (sinogram > high + span)).mean(axis=1)
    flat = np.ptp(quantiles, axis=0) < FLAT_SHARE * span
    usable: NDArray[np.bool_] = (outside <= np.median(outside) + VIEW_SHARE) & ~flat
    return usable if usable.sum() >= FEWEST_VIEWS else np.ones_like(usable)
