"""Side view of a volume, as it is stored and drawn."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class SideView:
    """Densest values of a reconstruction, seen from the side."""

    data: NDArray[np.float32]  # (slice, x or y) float32: the maximum over the other axis of each slice, in `unit`
    across: str  # remaining axis: x or y
    across_mm: tuple[float, float]  # (low, high): ends of the field along it
    # (low, high) or None: ends of the log along its length; None where slices have no spacing
    along_mm: tuple[float, float] | None
    unit: str  # unit of the data
