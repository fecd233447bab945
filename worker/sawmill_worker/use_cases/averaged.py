"""A scan that came as the mean over rows: masked rays are interpolated, and their deviations say what that costs."""

import math

import numpy as np
from numpy.typing import NDArray

from sawmill_worker.readers.averaged import AveragedRows
from sawmill_worker.tomography.bridging import bridged_samples


class AveragedRays:
    """The rays of such a scan, block by block.

    Parameters
    ----------
    averaged : AveragedRows
        As they came.

    Attributes
    ----------
    deviations : (views, detector) float32, or None
        Of the rays as they are used; None where none came.
    """

    def __init__(self, averaged: AveragedRows) -> None:
        self._averaged, self._masked, self._samples = averaged, 0, 0
        self.deviations = None if averaged.deviations is None else averaged.deviations.copy()

    def bridge(self, samples: NDArray[np.float32], first_view: int) -> None:
        """Interpolate masked rays, NaN among samples (views, 1, detector), in place."""
        rays = samples[:, 0]
        masked = np.isnan(rays)
        self._samples += masked.size
        if not masked.any():
            return
        self._masked += int(masked.sum())
        rays[...] = bridged_samples(rays, masked)
        if self.deviations is not None:
            for view in np.flatnonzero(masked.any(axis=1)):
                _widen(self.deviations[first_view + view], rays[view], masked[view])

    def remarks(self) -> tuple[str, ...]:
        """What came, and what was done to it."""
        known = "with their standard deviations" if self.deviations is not None else "without standard deviations"
        came = f"It came as the mean of the line integrals of {self._averaged.rows} rows, {known}."
        if not self._masked:
            return came, "No ray of it was masked: a nail in those rows counts as log."
        return came, f"{self._masked} of {self._samples} rays were masked, and interpolated along the detector."


def _widen(deviations: NDArray[np.float32], rays: NDArray[np.float32], masked: NDArray[np.bool_]) -> None:
    """Give bridged rays of one view (detector,) the deviation with which bridges of their width miss its other rays.

    The errors of a bridge are alike, so that its sum of independent ones would be too small: by the root of its width.
    None is known better than rays that were measured.
    """
    least = float(np.median(deviations[~masked]))
    edges = np.diff(masked.astype(np.int8), prepend=0, append=0)
    for first, last in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
        width = int(last - first)
        reach = width // 2 + 1
        missed = rays[reach:-reach] - 0.5 * (rays[: -2 * reach] + rays[2 * reach :])
        deviations[first:last] = math.sqrt(width) * max(float(np.sqrt(np.mean(missed**2))), least)
