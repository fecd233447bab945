"""A search that was stopped and starts again: the objective recalls the values that it has computed before.

A seeded search evaluates the same vectors in the same order as long as the objective returns the same values. So the
evaluations are the whole state of the search: they alone restore, bit for bit, the population, the energies, the random
generator and the position in the generation of a differential evolution, and the steps of the polish that follows.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FloatArray

Function = Callable[[FloatArray], float]


@dataclass(frozen=True, eq=False)
class Evaluations:
    """Vectors at which an objective was evaluated, and the values, in order.

    Raises
    ------
    ValueError
        The shapes do not agree.
    """

    vectors: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)))  # (n, parameters)
    values: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))  # (n,)

    def __post_init__(self) -> None:
        if self.vectors.ndim != 2 or self.values.shape != self.vectors.shape[:1]:
            raise ValueError(f"there must be a value for each vector, not {self.values.shape} for {self.vectors.shape}")


class RecallingObjective:
    """An objective that returns values of an earlier search, as long as that search evaluated the same vectors.

    Parameters
    ----------
    objective : callable
        Function from a vector (parameters,) to a value; equal vectors have equal values.
    earlier : Evaluations, optional
        Evaluations of a search that was stopped.
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
        """True if the next value may come from the earlier search."""
        return self.count < len(self._values)

    def __call__(self, vector: FloatArray) -> float:
        """Evaluate the objective at a vector (parameters,), or recall the value."""
        if self.recalls and not np.array_equal(self._vectors[self.count], vector):
            # This search differs from the earlier one: all remaining values of the earlier search are dropped.
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
        """Return all evaluations so far, recalled values included."""
        return Evaluations(np.array(self._vectors), np.array(self._values))
