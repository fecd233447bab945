"""The edge-preserving priors: penalties on the differences d between neighbouring pixels."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.reconstruction.iterative import _prior_numba as kernels
from sawmill_tomography.reconstruction.iterative.descent import Floats, Images, Indices
from sawmill_tomography.reconstruction.iterative.ring_directions import enlarged, ring_directions


@dataclass(frozen=True, eq=False)
class Prior(ABC):
    """A penalty with one scale and one strength for each image."""

    scale: Floats  # (images,): scale of the differences, in the unit of attenuation
    strength: Floats  # (images,)
    corner: Floats  # (images,): scale of the weak penalty on the corner pixel, which has no difference
    # The curvature over a difference d is stiffest * (1 + |d|^2 / scale^2)^-power.
    power: ClassVar[float]
    # The stiffness of flat regions as a share of the stiffest, which makes a good preconditioner.
    even_share: ClassVar[float] = 1.0
    has_directions: ClassVar[bool] = False  # True if images guide the prior (`directions_of`)
    # (images, scale, strength, gradient, values (images, bands)): adds the gradient, fills the values.
    kernel: ClassVar[Callable[..., Any]]

    @abstractmethod
    def stiffest(self) -> Floats:
        """Return the curvature over a difference of 0, (images,)."""

    @abstractmethod
    def corner_strength(self) -> Floats:
        """Return the strength of the penalty on the corner pixel, (images,); a pure number, as the objective is."""

    def add(self, images: Images, which: Indices, gradient: Images) -> Floats:
        """Add the gradient in place and return the values (named,), of images (named, n, n)."""
        bands = np.empty((len(images), -(-images.shape[1] // kernels.BAND)))
        self._differences(images, which, gradient, bands)
        corner, strength = images[:, -1, -1].astype(np.float64), self.corner_strength()[which]
        square = self.corner[which] ** 2
        gradient[:, -1, -1] += strength * 2.0 * corner / (square + corner**2)
        return np.asarray(bands.sum(axis=1) + strength * np.log1p(corner**2 / square))

    def _differences(self, images: Images, which: Indices, gradient: Images, values: Floats) -> None:
        """Add the gradient of the differences' penalty, and fill its values (named, bands)."""
        type(self).kernel(images, self.scale[which], self.strength[which], gradient, values)

    def scaling(self, images: Images, which: Indices, data_curvature: Floats) -> Images:
        """Return the square root of each pixel's softness relative to a flat image, (named, n, n)."""
        out = np.empty_like(images)
        kernels.scaling(images, self.scale[which], self.stiffest()[which], data_curvature[which], self.power, out)
        return out

    def only(self, index: int) -> Self:
        """Return the prior of one image."""
        one = slice(index, index + 1)
        return replace(self, scale=self.scale[one], strength=self.strength[one], corner=self.corner[one])

    def repeated(self, times: int) -> Self:
        """Return the prior of several copies of each image, one after the other."""
        return replace(
            self,
            scale=np.repeat(self.scale, times),
            strength=np.repeat(self.strength, times),
            corner=np.repeat(self.corner, times),
        )

    def directions_of(self, _images: Images, _grid: ImageGrid, _joined: Floats) -> Images | None:
        """Return the directions that first images show; None from a prior that has none.

        `_joined` (images - 1,): not 0 between neighbours along the log.
        """
        return None

    def directed(self, _directions: Images | None, _size: int) -> Self:
        """Return the prior with directions for images of this size."""
        return self

    def rescaled(self, factor: float) -> Self:
        """Return the same prior with its scales multiplied."""
        return replace(self, scale=self.scale * factor, corner=self.corner * factor)


class CauchyPrior(Prior):
    """Prior strength * sum log(1 + |d|^2 / scale^2): not convex (docs/understand/reconstruction.md)."""

    power = 1.0
    kernel = staticmethod(kernels.cauchy)

    def stiffest(self) -> Floats:
        """Return 2 strength / scale^2."""
        return np.asarray(2.0 * self.strength / self.scale**2)

    def corner_strength(self) -> Floats:
        """Return the strength of the differences."""
        return self.strength


class TotalVariationPrior(Prior):
    """Prior strength * scale * sum (sqrt(1 + |d|^2 / scale^2) - 1): convex (Rudin, Osher, Fatemi 1992, smoothed)."""

    power = 0.5
    # Few differences are as small as the smoothing: 1 / 16 to 1 / 64 halve the iterations of 1 (20 and 45 views).
    even_share = 1.0 / 20.0
    kernel = staticmethod(kernels.total_variation)

    def stiffest(self) -> Floats:
        """Return strength / scale."""
        return np.asarray(self.strength / self.scale)

    def corner_strength(self) -> Floats:
        """Return strength times scale."""
        return self.strength * self.scale


@dataclass(frozen=True, eq=False)
class RingPrior(TotalVariationPrior):
    """Total variation in which differences along r count less: |d|^2 - share (r . d)^2 in place of |d|^2."""

    has_directions: ClassVar[bool] = True

    share: Floats  # (images,): 0 is total variation
    # r, at most 1 long: (images, 2, n, n) or (1, 2, n, n), along x and y; None before an image has shown directions
    directions: Images | None = None

    def directions_of(self, images: Images, grid: ImageGrid, joined: Floats) -> Images | None:
        """Return the directions that images show (`ring_directions`)."""
        return ring_directions(images, grid, self.corner, joined)

    def directed(self, directions: Images | None, size: int) -> Self:
        """Return the prior with these directions, which may be of larger pixels."""
        return self if directions is None else replace(self, directions=enlarged(directions, size))

    def only(self, index: int) -> Self:
        """Return the prior of one image, with common directions."""
        return replace(super().only(index), share=self.share[index : index + 1])

    def repeated(self, times: int) -> Self:
        """Return the prior of several copies of each image, one after the other, with common directions."""
        return replace(super().repeated(times), share=np.repeat(self.share, times))

    def _differences(self, images: Images, which: Indices, gradient: Images, values: Floats) -> None:
        if self.directions is None:
            super()._differences(images, which, gradient, values)
            return
        scale, strength, share = self.scale[which], self.strength[which], self.share[which]
        kernels.ring_variation(images, scale, strength, share, self.directions, which, gradient, values)

    def scaling(self, images: Images, which: Indices, data_curvature: Floats) -> Images:
        """Return the square root of each pixel's softness relative to a flat image, (named, n, n)."""
        if self.directions is None:
            return super().scaling(images, which, data_curvature)
        out, scale, stiffest = np.empty_like(images), self.scale[which], self.stiffest()[which]
        data, share = data_curvature[which], self.share[which]
        kernels.ring_scaling(images, scale, stiffest, data, share, self.directions, which, out)
        return out
