"""A search that was ended in the middle, begun again: its objective recalls what it has computed before.

A seeded search asks the same questions in the same order as long as it gets the same answers. So its evaluations are
all of its state: from them alone, the population of a differential evolution, its energies, its generator and its place
in the generation come out again, bit for bit, and so do the steps of a polish after it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FloatArray

Function = Callable[[FloatArray], float]


@dataclass(frozen=True, eq=False)
class Evaluations:
    """What an objective was asked and answered, in order.

    Attributes
    ----------
    vectors : (n, parameters) float64
    values : (n,) float64

    Raises
    ------
    ValueError
        The shapes do not agree.
    """

    vectors: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)))
    values: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if self.vectors.ndim != 2 or self.values.shape != self.vectors.shape[:1]:
            msg = f"there must be a value for each vector, not {self.values.shape} for {self.vectors.shape}"
            raise ValueError(msg)


class RecallingObjective:
    """Answers as an objective does; the first answers come from an earlier search, as long as it asked the same.

    Parameters
    ----------
    objective : callable
        Vector (parameters,) to a value; equal vectors have equal values.
    earlier : Evaluations, optional
        Of a search that was ended.
    on_computed : callable, optional
        Called after each value that was computed, and not recalled.
    """

    def __init__(
        self,
        objective: Function,
        earlier: Evaluations | None = None,
        on_computed: Callable[["RecallingObjective"], None] | None = None,
    ) -> None:
        self._objective, self._on_computed = objective, on_computed
        earlier = earlier or Evaluations()
        self._vectors = list(earlier.vectors)
        self._values: list[float] = earlier.values.tolist()
        self.count = 0

    @property
    def recalls(self) -> bool:
        """Whether the next answer may be an earlier one."""
        return self.count < len(self._values)

    def __call__(self, vector: FloatArray) -> float:
        """The value at a vector (parameters,)."""
        if self.recalls and not np.array_equal(self._vectors[self.count], vector):
            # Another search than the earlier one: from here on nothing of that holds.
            del self._vectors[self.count :], self._values[self.count :]
        self.count += 1
        if self.count <= len(self._values):
            return self._values[self.count - 1]
        value = self._objective(vector)
        self._vectors.append(np.array(vector, np.float64))
        self._values.append(value)
        if self._on_computed is not None:
            self._on_computed(self)
        return value

    def evaluations(self) -> Evaluations:
        """All so far, the recalled ones included."""
        return Evaluations(np.array(self._vectors), np.array(self._values))
