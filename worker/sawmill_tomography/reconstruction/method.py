"""What a reconstruction method declares: its options, its memory, and how it reconstructs a block.

A method's fields are its options, by the names of the request's fields (docs/adding.md).
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.reconstruction.estimate import Estimate
from sawmill_tomography.reconstruction.iterative.progress import OnProgress

# Images that a descent keeps for each slice, and the candidates that a choice reconstructs side by side.
IMAGES_OF_A_DESCENT, CANDIDATES_AT_ONCE = 24, 10


@dataclass(frozen=True)
class DirectMethod(ABC):
    """Computes the field's image from the data in one pass, with no step towards explaining them.

    It needs no pixels outside the field. Several blocks are reconstructed concurrently.
    """

    @abstractmethod
    def reconstruct(self, projector: Projector, lines: Image) -> Estimate:
        """Reconstruct a block (slices, views, detector) of any strides."""

    def seconds(self, _projector: Projector, _slices: int) -> float | None:
        """The time from rows to the volume's file, where it is known beforehand."""
        return None

    def remark_on(
        self, _projector: Projector, _image: Image, _misfit: float, _line: Image, _noise: float
    ) -> str | None:
        """What a slice's misfit, against the noise of its line integrals (views, detector), shows; None if nothing."""
        return None


@dataclass(frozen=True)
class FittedMethod(ABC):
    """Fits an image to the measured rays, so that it needs pixels wherever there is wood, beyond the field too.

    Attributes
    ----------
    least_images : int
        Images of float32 that are in memory at once for a single slice.
    pairs_a_slice : float
        Forward and adjoint projections that a slice takes, its parameters being chosen.
    choosing_cost_slices, coupling_cost_slices : float
        The cost of `chosen`, and of a `CoupledMethod`'s `with_coupling_chosen`, relative to a slice of a block.
    leaves_out : bool
        Whether rays can be left out. All rays of another method weigh the same.
    shrinks : bool
        Whether values are drawn towards 0: those of a region, where few rays hold them, are drawn to larger pixels.
    """

    least_images: ClassVar[int]
    pairs_a_slice: ClassVar[float]
    choosing_cost_slices: ClassVar[float] = 0.0
    coupling_cost_slices: ClassVar[float] = 0.0
    leaves_out: ClassVar[bool] = False
    shrinks: ClassVar[bool] = False

    @property
    def is_open(self) -> bool:
        """Whether parameters are to be chosen from one slice of the log, the same for all."""
        return False

    def chosen(
        self,
        _projector: Projector,
        _line: Image,
        *,
        noise: FloatArray,  # noqa: ARG002 - of methods with open parameters
        on_progress: OnProgress,  # noqa: ARG002
    ) -> Self:
        """The method with the parameters chosen from a slice (views, detector), its noise as of `reconstruct`."""
        return self

    @property
    def choice(self) -> dict[str, float]:
        """What `chosen` chose, for `with_choice`."""
        return {}

    def with_choice(self, _choice: Mapping[str, float]) -> Self:
        """The method with the parameters that another one of the same options chose."""
        return self

    @abstractmethod
    def reconstruct(
        self,
        projector: Projector,
        lines: Image,
        *,
        noise: FloatArray,
        on_progress: OnProgress,
    ) -> Estimate:
        """Reconstruct a block.

        Parameters
        ----------
        lines : (slices, views, detector) float32
            Line integrals whose air stands at 0; none is 0 in every ray.
        noise : float64, broadcasts with lines
            Standard deviation of each line integral. One number a slice, unless the method `leaves_out` rays: infinite
            of a ray without weight, whose line is interpolated.
        on_progress : callable
            Called with the share of the block that is done.
        """


@dataclass(frozen=True)
class CoupledMethod(FittedMethod):
    """A fitted method whose slices may help their neighbours."""

    @property
    @abstractmethod
    def halo(self) -> int:
        """Slices beyond either end of a block that help it; 0 where it is known that each slice is by itself."""

    @property
    @abstractmethod
    def coupling_is_open(self) -> bool:
        """Whether the coupling is to be chosen from neighbouring slices."""

    @abstractmethod
    def with_coupling_chosen(
        self,
        projector: Projector,
        lines: Image,
        *,
        numbers: NDArray[np.int64],
        others_stay: bool,
        noise: FloatArray,
        on_progress: OnProgress,
    ) -> Self:
        """The method, no other parameter open, with the coupling chosen from slices (slices, views, detector).

        Parameters
        ----------
        numbers
            As of `reconstruct`.
        others_stay : bool
            Whether the other parameters were given: they stay then, whatever the coupling.
        """

    @abstractmethod
    def reconstruct(
        self,
        projector: Projector,
        lines: Image,
        *,
        noise: FloatArray,
        on_progress: OnProgress,
        numbers: NDArray[np.int64] | None = None,
    ) -> Estimate:
        """As of `FittedMethod`.

        Parameters
        ----------
        numbers : (slices,) int64, optional
            Of the slices along the log: those whose numbers follow each other are neighbours. By default all are.
        """


Method = DirectMethod | FittedMethod
