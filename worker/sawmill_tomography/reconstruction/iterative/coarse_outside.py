"""A region of interest in its own pixels, and the log outside of it in larger ones.

Rays through a region cross the wood outside of it, too. Total variation reconstructs the whole log with larger pixels;
the line integrals of the part outside are subtracted from the data, and the residual belongs to the region.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np

from sawmill_tomography.geometry.geometry import FanViews, FloatArray
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.reconstruction.iterative.coarse_to_fine import finer
from sawmill_tomography.reconstruction.total_variation import total_variation
from sawmill_tomography.reconstruction.total_variation_weights import choose_weight

# The constants of this file were measured with benchmarks/region.py at 3ab7f653.
# Ratio of the pixel sizes outside and inside: the first of these with which this number of pixels lies across the log.
FACTORS, LEAST_ACROSS = (4, 2), 160
# Large pixels around the field that are reconstructed with the field's own: a step at the border stays outside.
MARGIN = 2
# Large pixels beyond the log, from which the descent takes a support region whose size can be halved.
ROOM = 6
# Two grids with more than this share of the pixels that one grid over all of the log has save too little.
WORTH_WHILE = 0.5
# The weight outside is chosen from this number of views at most, and assumed to rise with the square root of the views:
# from 360 views, three times or a third of the weight changes the region's error by less than 1 %.
CHOOSING_VIEWS = 45

Part = tuple[slice, slice]


class TwoGrids(NamedTuple):
    """The pixels of a region, and the several times larger pixels of the whole log."""

    region: ImageGrid  # the field with a margin, in the field's own pixels
    field: Part  # (slice, slice): part of the region that is the field
    whole: ImageGrid  # large pixels over all of the log
    inside: Part  # (slice, slice): the large pixels that the region covers

    @property
    def pixels(self) -> int:
        """Number of pixels of both grids."""
        return self.region.size**2 + self.whole.size**2

    @classmethod
    def of(cls, field: ImageGrid, radius_mm: float) -> "TwoGrids | None":
        """Return two grids for a field of a log within a radius of the COR; None where one grid costs little more."""
        h, one, _ = field.pixel_mm, *field.around(radius_mm)
        factor = next((factor for factor in FACTORS if 2.0 * radius_mm >= LEAST_ACROSS * factor * h), None)
        if factor is None:
            return None
        before = MARGIN * factor
        # A size that can be halved twice.
        size = -(-(field.size + 2 * before) // 4) * 4
        side = size * h
        centre = (field.low_mm[0] - before * h + 0.5 * side, field.low_mm[1] - before * h + 0.5 * side)
        whole, inside = ImageGrid(size // factor, side, centre).around(radius_mm + ROOM * factor * h)
        part = slice(before, before + field.size)
        grids = cls(ImageGrid(size, side, centre), (part, part), whole, inside)
        return grids if grids.pixels <= WORTH_WHILE * one.size**2 else None


def fitted_size(field: ImageGrid, radius_mm: float) -> int:
    """Return the side of a square with the pixels that a fitted method needs for a log within a radius of the COR."""
    grids = TwoGrids.of(field, radius_mm)
    return field.around(radius_mm)[0].size if grids is None else math.ceil(math.sqrt(grids.pixels))


@dataclass(frozen=True, eq=False)
class CoarseOutside:
    """The part of the log outside of a region, and its line integrals."""

    region: Projector  # projectors of both grids
    whole: Projector
    grids: TwoGrids
    non_negative: bool  # True if attenuation is at least 0
    weight: float | None = None  # weight of total variation, in 1 / attenuation; None until it is chosen

    @classmethod
    def of(cls, geometry: FanViews, grids: TwoGrids, *, non_negative: bool) -> Self:
        """Make the grids' projectors for a scan; the weight is still to be chosen."""
        return cls(Projector(geometry, grids.region), Projector(geometry, grids.whole), grids, non_negative)

    def chosen(self, line: Image, noise: FloatArray) -> Self:
        """Return a copy with the weight chosen from a slice (views, detector) and its noise."""
        geometry = self.whole.geometry
        step = max(1, len(line) // CHOOSING_VIEWS)
        few = Projector(geometry.at(slice(None, None, step)), self.grids.whole)
        noise = np.broadcast_to(noise, (1, *line.shape))[:, ::step]
        choice = choose_weight(few, line[::step], noise=noise, non_negative=self.non_negative)
        return replace(self, weight=math.sqrt(step) * choice.weight)

    def taken_out(self, lines: Image, noise: FloatArray, *, inside: bool = False) -> tuple[Image, Image]:
        """Return the lines minus the part outside, and the offset of the region's images, (slices, n, n).

        Parameters
        ----------
        lines : (slices, views, detector) float32
            Line integrals; the noise broadcasts with them, and the weight has been chosen.
        inside : bool
            True to subtract the large pixels that the region covers too, interpolated linearly: they are then the
            offset of the region's images, which is 0 otherwise.
        """
        assert self.weight is not None  # noqa: S101
        images = total_variation(
            self.whole, lines, weight=self.weight, noise=noise, non_negative=self.non_negative
        ).image
        size = self.grids.region.size
        below = self._inside(images) if inside else np.zeros((len(images), size, size), np.float32)
        images[(slice(None), *self.grids.inside)] = 0.0
        rest = lines - self.whole.forward(images)
        return rest - self.region.forward(below) if inside else rest, below

    def _inside(self, images: Image) -> Image:
        """Return the region of images with large pixels, in its own pixels."""
        halvings = round(math.log2(self.grids.whole.pixel_mm / self.grids.region.pixel_mm))
        for _ in range(halvings):
            images = finer(images)
        x, y = (slice(part.start << halvings, part.stop << halvings) for part in self.grids.inside)
        return np.ascontiguousarray(images[:, x, y], np.float32)
