"""A few views that the fit to the others does not explain: the phantom or the turntable stood elsewhere."""

from dataclasses import replace

import numpy as np

from sawmill_worker.tomography.calibration.faults.finding import AdjustedFit, Finding
from sawmill_worker.vocabulary import Adjustment

# A view is inconsistent when its neighbouring cells share more than this multiple of the views' residual power
# (median), if no more than this share of the views is. What is wrong with a drawing shows in all views, and at most
# three times as strongly in some (benchmarks/misspecified.py).
INCONSISTENT, MOST_VIEWS = 3.0, 0.1
ROUNDS = 3


def _adjust(now: AdjustedFit) -> AdjustedFit:
    current = now
    inconsistent = np.zeros(len(now.data.sinogram), bool)
    for _ in range(ROUNDS):
        data = current.data
        weights = np.ones_like(data.sinogram) if data.weights is None else data.weights
        used = np.sqrt(weights) * (data.sinogram - current.model)
        # Noise, however strong in deep shadow, is not shared by neighbours; what a model lacks is.
        shared, power = (used[:, 1:] * used[:, :-1]).sum(axis=1), (used**2).sum(axis=1)
        found = shared > INCONSISTENT * np.median(power[power > 0.0])
        if not found.any() or (inconsistent | found).sum() > MOST_VIEWS * len(inconsistent):
            break
        remaining = replace(data, weights=np.where(found[:, None], 0.0, weights))
        again = now.refitted(remaining, current.fit)
        if again is None:
            break
        current, inconsistent = replace(now, data=remaining, fit=again), inconsistent | found
    if not inconsistent.any():
        return now
    return now.after(
        current.data, current.fit, f"{int(inconsistent.sum())} views that do not fit the others were left out"
    )


INCONSISTENT_VIEWS = Finding(Adjustment.OUTLIERS, _adjust)
