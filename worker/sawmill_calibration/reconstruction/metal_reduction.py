"""Metal in a block of slices: removed before a method solves the block, counted, and put back into the images."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from sawmill_calibration.reconstruction.method_findings import MetalCount
from sawmill_contracts.reconstructions import MetalReport
from sawmill_tomography.geometry.geometry import FanBeamGeometry
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.reconstruction.metal import INTERPOLATION, WITHOUT_RAYS, LogMetal, MetalSearch

Images = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class WithoutMetal:
    """A block (slices, views, detector) whose rays through metal are interpolated, or less the metal.

    Metal is by the slice's index; the uncertainty of rays through it is infinite for rays to be left out.
    """

    lines: Images
    metal: Mapping[int, LogMetal] = field(default_factory=dict)
    untreated: frozenset[int] = frozenset()
    uncertainty: Images | None = None

    def count(self, selected: NDArray[np.bool_] | None = None) -> MetalCount:
        """Count the metal in the block, or in the slices of the mask `selected` (slices,)."""
        traces = [metal.trace for index, metal in self.metal.items() if selected is None or selected[index]]
        return MetalCount(
            len(traces),
            sum(int(trace.sum()) for trace in traces),
            sum(trace.size for trace in traces),
            sum(selected is None or bool(selected[index]) for index in self.untreated),
        )

    def put_back(self, images: Images, grid: ImageGrid) -> None:
        """Add the metal to images (slices, size, size), in place."""
        for index, metal in self.metal.items():
            images[index] += metal.body.on(grid)


class MetalReduction:
    """Reduction of metal in the blocks of a log: rays are interpolated, left out, or weighed where metal is thin."""

    def __init__(
        self, geometry: FanBeamGeometry, radius_mm: float, *, leave_out: bool, weigh: bool, enabled: bool
    ) -> None:
        self._search = MetalSearch.of(geometry, radius_mm) if enabled else None
        self._leave_out, self._weigh, self._working = leave_out, weigh, Lock()

    def __call__(self, lines: Images) -> WithoutMetal:
        """Return a block (slices, views, detector) of any strides without its metal."""
        if self._search is None:
            return WithoutMetal(lines)
        with self._working:
            searched = dict(enumerate(self._search.find(np.ascontiguousarray(lines))))
        metals = {index: metal for index, metal in searched.items() if metal is not None and not metal.is_too_much}
        untreated = frozenset(index for index, metal in searched.items() if metal is not None and metal.is_too_much)
        if not metals:
            return WithoutMetal(lines, untreated=untreated)
        without, uncertainty = lines.copy(), np.zeros(lines.shape, np.float32)
        for index, metal in metals.items():
            without[index] = metal.freed if self._weigh else metal.filled
            uncertainty[index] = metal.uncertainty if self._weigh else np.where(metal.trace, math.inf, 0.0)
        return WithoutMetal(without, metals, untreated, uncertainty if self._leave_out else None)

    def report(self, count: MetalCount) -> MetalReport | None:
        """Return the report of the counted metal; None if there is none."""
        if not (count.slices or count.untreated_slices):
            return None
        return MetalReport(
            slices=count.slices,
            samples=count.samples,
            share_of_samples=count.samples / max(count.all_samples, 1),
            untreated_slices=count.untreated_slices,
            treatment="left-out" if self._leave_out else "interpolated",
            source=WITHOUT_RAYS if self._leave_out else INTERPOLATION,
        )
