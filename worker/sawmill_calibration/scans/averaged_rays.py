"""A scan that was sent as the mean over rows: masked rays are interpolated and get larger standard deviations."""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.input.averaged import AveragedRows
from sawmill_tomography.sinograms.masked_rays import bridge_masked
from sawmill_vocabulary.messages import Reason, selected
from sawmill_vocabulary.reading_messages import PreparingMessage


class AveragedRays:
    """Rays of a scan (views, 1, detector) that was sent as a mean of rows; deviations are 0 where not known."""

    def __init__(self, averaged: AveragedRows, shape: tuple[int, int, int]) -> None:
        self._averaged, self._shape, self._masked, self._samples = averaged, shape, 0, 0
        self.deviations = None if averaged.deviations is None else averaged.deviations.copy()

    def bridge(self, samples: NDArray[np.float32], first_view: int) -> None:
        """Interpolate masked rays, NaN in (views, 1, detector), in place; their deviations are at least the median."""
        rays = samples[:, 0]
        masked = np.isnan(rays)
        self._samples += masked.size
        if not masked.any():
            return
        self._masked += int(masked.sum())
        bridged = rays.astype(np.float64)
        missed = bridge_masked(bridged, masked)
        rays[...] = bridged
        if self.deviations is None:
            self.deviations = np.zeros(self._shape[::2], np.float32)
        for deviations, misses, gaps in zip(self.deviations[first_view:], missed, masked, strict=False):
            deviations[gaps] = np.maximum(misses[gaps], np.median(deviations[~gaps]))

    def remarks(self) -> tuple[Reason, ...]:
        """Report what was sent, and how it was changed."""
        alone = self._averaged.deviations is None
        came = PreparingMessage.MEAN_OF_ROWS if alone else PreparingMessage.MEAN_WITH_DEVIATIONS
        masked = (
            PreparingMessage.RAYS_MASKED(masked=self._masked, samples=self._samples)
            if self._masked
            else PreparingMessage.NO_RAY_MASKED()
        )
        return came(rows=self._averaged.rows), masked


def of_masked_rays(remarks: Collection[str]) -> str | None:
    """Select the remark on a prepared scan that reports masked rays; None if no ray was masked."""
    return next(selected(remarks, PreparingMessage.RAYS_MASKED), None)
