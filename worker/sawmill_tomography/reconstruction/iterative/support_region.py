"""The support region: the pixels that can hold the log. The descent runs there first, and then on the full grid."""

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy

from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.iterative.descent import Images, Minimum
from sawmill_tomography.reconstruction.iterative.penalised import InverseCurvature, Objective, descend
from sawmill_tomography.reconstruction.iterative.progress import OnProgress, Phases
from sawmill_tomography.reconstruction.object_extent import object_radius_mm

# The constants of this file were measured with benchmarks/iterative.py at 3ab7f653.
# A support region with more than this share of all pixels saves nothing.
SMALL_SHARE = 0.6
# Largest share of the iterations for the descent on the support region: the air around the log needs some iterations
# too.
SUPPORT_ITERATION_SHARE = 2.0 / 3.0
# Iterations on the full grid after which most images have converged when the support region has, and the cost of one
# relative to an iteration on the support region.
FULL_GRID_ITERATIONS, FULL_GRID_COST = 20, 0.8
# Pixels kept around the part that the scan shows.
MARGIN = 2


@dataclass(frozen=True, eq=False)
class SupportRegion:
    """The square of pixels that can hold the log; all pixels outside are air."""

    projector: Projector  # projector of the support region alone
    part: tuple[slice, slice]  # (slice, slice): part of the full image that is the region
    size: int  # size of the full image

    @classmethod
    def of(
        cls, projector: Projector, lines: Images, *, non_negative: bool = True, multiple: int = 1
    ) -> "SupportRegion":
        """Return the region that all slices (slices, views, detector) show, with a margin, sized for a fast transform.

        It is the full grid where a slice shows nothing but air, or attenuation may be negative. Its size is a multiple
        of `multiple`, where the full grid has room for it.
        """
        if not non_negative:
            return cls.full_grid(projector)
        grid = projector.grid
        radii = [object_radius_mm(projector.geometry, line) for line in lines]
        if min(radii) == 0.0:
            return cls.full_grid(projector)
        radius = max(radii) + MARGIN * grid.pixel_mm
        ends = [
            (math.floor((-radius - low) / grid.pixel_mm), math.ceil((radius - low) / grid.pixel_mm))
            for low in grid.low_mm
        ]
        ends = [(max(low, 0), min(high, grid.size)) for low, high in ends]
        size = scipy.fft.next_fast_len(max(1, *(high - low for low, high in ends)), real=True)
        # Concentric with a field that is centred on the COR: there, views a quarter turn apart are faster.
        while size % multiple or (multiple == 1 and (grid.size - size) % 2):
            size = scipy.fft.next_fast_len(size + 1, real=True)
        size = min(size, grid.size)
        low_x, low_y = (min(max((low + high - size) // 2, 0), grid.size - size) for low, high in ends)
        field = size * grid.pixel_mm
        centre = (
            grid.low_mm[0] + low_x * grid.pixel_mm + 0.5 * field,
            grid.low_mm[1] + low_y * grid.pixel_mm + 0.5 * field,
        )
        part = slice(low_x, low_x + size), slice(low_y, low_y + size)
        return cls(Projector(projector.geometry, ImageGrid(size, field, centre)), part, grid.size)

    @classmethod
    def full_grid(cls, projector: Projector) -> "SupportRegion":
        """Return the region of all pixels."""
        size = projector.grid.size
        return cls(projector, (slice(size), slice(size)), size)

    @property
    def is_small(self) -> bool:
        """True if the region is so small that a descent there first saves time."""
        return self.projector.grid.size**2 < SMALL_SHARE * self.size**2

    def embedded(self, images: Images) -> Images:
        """Return images of the region (images, n, n) as images of the full grid, air around them."""
        out = np.zeros((len(images), self.size, self.size), np.float32)
        out[:, *self.part] = images
        return out


def descend_from_support(
    objective: Objective,
    support: SupportRegion,
    start: Images,
    *,
    non_negative: bool,
    iterations: int,
    tolerance: float,
    usual: int,
    preconditioned: bool = True,
    on_progress: OnProgress | None = None,
) -> Minimum:
    """Minimise on the support region until convergence, where it is small, and then on the full grid.

    The air around the log follows the log within some iterations and changes it little: most of the work needs the
    support region only.

    `start` (images, n, n) float32: start images on the support region; the rest is air.
    """
    preconditioner = InverseCurvature if preconditioned else None
    phases = Phases(on_progress, support=1.0 if support.is_small else 0.0, full_grid=FULL_GRID_COST)
    spent = np.zeros(len(start), np.int64)
    if support.is_small:
        near = descend(
            replace(objective, projector=support.projector),
            start,
            non_negative=non_negative,
            iterations=int(SUPPORT_ITERATION_SHARE * iterations),
            tolerance=tolerance,
            preconditioner=preconditioner,
            on_iteration=phases.descent("support", usual),
        )
        start, spent = near.images, near.iterations
    minimum = descend(
        objective,
        support.embedded(start),
        non_negative=non_negative,
        iterations=iterations - int(spent.max()),
        tolerance=tolerance,
        preconditioner=preconditioner,
        on_iteration=phases.descent("full_grid", FULL_GRID_ITERATIONS if support.is_small else usual),
    )
    return replace(minimum, iterations=spent + minimum.iterations)
