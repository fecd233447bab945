"""Base classes of reconstruction methods: options, memory, and the reconstruction of a block.

A method's fields are its options, by the names of the request's fields (docs/understand/adding.md).
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.reconstruction.estimate import Estimate
from sawmill_tomography.reconstruction.iterative.progress import OnProgress

# Images that a descent keeps for each slice, and the candidates that a choice reconstructs in parallel.
IMAGES_OF_A_DESCENT, CANDIDATES_AT_ONCE = 24, 10


@dataclass(frozen=True)
class DirectMethod(ABC):
    """A method that computes the field's image from the data in one pass, without fitting the data.

    A direct method needs no pixels outside the field. Several blocks are reconstructed concurrently.
    """

    @abstractmethod
    def reconstruct(self, projector: Projector, lines: Image) -> Estimate:
        """Reconstruct a block (slices, views, detector) of any strides."""

    def seconds(self, _projector: Projector, _slices: int) -> float | None:
        """Return the time from rows to the volume's file, where it is known beforehand."""
        return None

    def remark_on(
        self, _projector: Projector, _image: Image, _misfit: float, _line: Image, _noise: float
    ) -> str | None:
        """Return a remark on a slice's misfit, given the noise of its line integrals (views, detector), or None."""
        return None


@dataclass(frozen=True)
class FittedMethod(ABC):
    """A method that fits an image to the measured rays, so it needs pixels for all wood, outside the field too."""

    least_images: ClassVar[int]  # images of float32 that are in memory at once for a single slice
    pairs_a_slice: ClassVar[float]  # forward and adjoint projections for a slice, with its parameters already chosen
    # Cost of `chosen`, and of `TotalVariation.with_coupling_chosen`, relative to a slice of a block
    choosing_cost_slices: ClassVar[float] = 0.0
    coupling_cost_slices: ClassVar[float] = 0.0
    leaves_out: ClassVar[bool] = False  # True if rays can be left out. Otherwise all rays have the same weight
    weighs: ClassVar[bool] = False  # True if each ray's own noise gives its weight, whatever the settings
    # True if values are drawn towards 0. In a region, where few rays determine them, they are drawn to larger pixels.
    shrinks: ClassVar[bool] = False

    @property
    def is_open(self) -> bool:
        """True if parameters are to be chosen from one slice of the log, the same for all slices."""
        return False

    def chosen(
        self,
        _projector: Projector,
        _line: Image,
        *,
        noise: FloatArray,  # noqa: ARG002 - of methods with open parameters
        on_progress: OnProgress,  # noqa: ARG002
    ) -> Self:
        """Return the method with parameters chosen from a slice (views, detector); `noise` is that slice's."""
        return self

    @property
    def choice(self) -> dict[str, float]:
        """Parameters chosen by `chosen`, for `with_choice`."""
        return {}

    def with_choice(self, _choice: Mapping[str, float]) -> Self:
        """Return the method with the parameters that another one of the same options chose."""
        return self

    @abstractmethod
    def reconstruct(
        self, projector: Projector, lines: Image, *, noise: FloatArray, on_progress: OnProgress
    ) -> Estimate:
        """Reconstruct a block.

        Parameters
        ----------
        lines : (slices, views, detector) float32
            Line integrals whose air is at 0; none is 0 in every ray.
        noise : float64, broadcasts with lines
            Standard deviation of each line integral. One number a slice, unless the method `leaves_out` rays: infinite
            for a ray without weight, whose line is interpolated.
        on_progress : callable
            Called with the finished share of the block.
        """


Method = DirectMethod | FittedMethod
