"""Which method for which data: method="auto"."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sawmill_worker.tomography.geometry import FanBeamGeometry, GeometryError, view_weights
from sawmill_worker.tomography.noise import estimated_noise
from sawmill_worker.vocabulary import ReconstructionMethod


@dataclass(frozen=True)
class Recommendation:
    """A method and, in one sentence, why."""

    method: ReconstructionMethod
    reason: str


# From here a prior gains too little for a thousand times the time. On the published log, 2 per cent noise, the relative
# error of FBP against that of total variation is 0.51 to 0.13 from 20 views, 0.20 to 0.10 from 90, 0.15 to 0.09 from
# 180 (benchmarks/paper/methods.py).
ENOUGH_VIEWS = 180
MUCH_NOISE = 0.03


def recommend(geometry: FanBeamGeometry, sinogram: ArrayLike) -> Recommendation:
    """The method for a sinogram (views, detector), by its views and its noise.

    Filtered back-projection where the views are dense all round and the noise small, since it takes milliseconds;
    otherwise total variation, whose error was the lowest on every simulated log (benchmarks/choosing.py).
    """
    data = np.ascontiguousarray(sinogram, np.float32)
    views = geometry.angles_rad.size
    rms = float(np.sqrt(np.mean(np.square(data, dtype=np.float64))))
    share = estimated_noise(data) / max(rms, 1e-30)
    try:
        view_weights(geometry.angles_rad)
    except GeometryError:
        return Recommendation(
            ReconstructionMethod.TOTAL_VARIATION,
            f"the {views} views leave a gap that filtered back-projection cannot bridge",
        )
    if views < ENOUGH_VIEWS:
        return Recommendation(
            ReconstructionMethod.TOTAL_VARIATION,
            f"{views} views are fewer than the {ENOUGH_VIEWS} that leave filtered back-projection free of streaks",
        )
    if share > MUCH_NOISE:
        return Recommendation(
            ReconstructionMethod.TOTAL_VARIATION,
            f"the noise is {100.0 * share:.2g} % of the signal, more than filtered back-projection averages out",
        )
    return Recommendation(
        ReconstructionMethod.FBP,
        f"{views} views all round with {100.0 * share:.2g} % noise leave filtered back-projection little to gain from",
    )
