"""Scans that were sent as the mean over detector rows: their deviations, and a check that they are line integrals."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.plausible import LARGEST_LOGARITHM, check_finite, falls, level_of_air, profile_of

# Share of a view's rays. Masked rays are interpolated, and a log's shadow is a third of the detector or more.
MOST_MASKED = 0.2
# Least line integral of air. The beam behind air is the flat field's but for the tube's drift: e times as many counts
# are impossible.
LEAST_AIR = -1.0


@dataclass(frozen=True, eq=False)
class AveragedRows:
    """Origin of a scan's one row as a mean over rows."""

    rows: int  # the number of detector rows whose line integrals were averaged
    # (views, detector) float32, or None: the standard deviation of each mean; infinite where a ray is masked
    deviations: NDArray[np.float32] | None

    @classmethod
    def of(cls, rows: int, shape: tuple[int, ...], deviations: NDArray[np.float32] | None) -> Self:
        """Check the shapes of the projections as they were sent, and of their deviations: `wrong-shape`."""
        if len(shape) == 3 and shape[1] != 1:
            raise UnreadableScan(
                "wrong-shape",
                f"averaged_rows says that {rows} rows were averaged, so projections are (views, detector), and these "
                f"are (views, rows, detector) = {shape}: send their mean over the rows, or leave averaged_rows out",
            )
        if deviations is None:
            return cls(rows, None)
        if deviations.shape != shape:
            raise UnreadableScan(
                "wrong-shape",
                f"deviations have the shape {deviations.shape} and the line integrals {shape}; there must be one of "
                "each line integral",
            )
        return cls(rows, deviations.reshape(shape[0], shape[-1]))

    def mask(self, samples: NDArray[np.float32], first_view: int) -> None:
        """Make the masked rays among samples (views, 1, detector) NaN, in place, and check the samples."""
        if self.deviations is not None:
            deviations = self.deviations[first_view : first_view + len(samples)]
            _check_deviations(deviations, samples[:, 0], first_view)
            samples[:, 0][np.isinf(deviations)] = np.nan
        masked = np.isnan(samples).sum(axis=(1, 2))
        view = int(np.argmax(masked))
        if masked[view] > MOST_MASKED * samples.shape[2]:
            raise UnreadableScan(
                "not-finite",
                f"{masked[view]} of {samples.shape[2]} rays of view {first_view + view} are masked, as NaN or by an "
                f"infinite deviation; at most {MOST_MASKED:.0%} may be: leave the view out, with its angle",
            )
        for view, image in enumerate(samples, first_view):
            check_finite("view", view, np.where(np.isnan(image), np.float32(0.0), image))
        _check_logarithms(samples[:, 0])


def _check_deviations(deviations: NDArray[np.float32], rays: NDArray[np.float32], first_view: int) -> None:
    # A number that only means "not known" would be used as a weight next to real deviations.
    largest = float(np.max(np.abs(rays), where=np.isfinite(rays), initial=0.0))
    wrong = ~((deviations > 0.0) & ((deviations <= largest) | np.isinf(deviations))) & ~np.isnan(rays)
    if wrong.any():
        view, cell = (int(i) for i in np.unravel_index(np.argmax(wrong), wrong.shape))
        raise UnreadableScan(
            "out-of-range",
            f"the standard deviation of view {first_view + view}, cell {cell} is {deviations[view, cell]:g}; it must "
            f"be above 0, not above the largest line integral ({largest:.3g}), and infinite where the ray is masked",
        )


def _check_logarithms(rays: NDArray[np.float32]) -> None:
    """Refuse values too large for a logarithm, that are no logarithm of counts over flats, or fall behind the log."""
    take = (
        "take -ln((counts - dark) / (flat - dark)) of every row first and average that over the rows, because -ln of a "
        "mean is not the mean of -ln"
    )
    largest = float(np.nanmax(rays))
    if largest > LARGEST_LOGARITHM:
        raise UnreadableScan(
            "contradiction",
            f"the values reach {largest:.3g} and no -ln of a transmission is above {LARGEST_LOGARITHM:.0f}, so they "
            f"are counts or in another unit: {take}",
        )
    profile = profile_of(rays)
    level = level_of_air(profile)
    if falls(profile):
        raise UnreadableScan(
            "contradiction",
            f"the values fall from {level:.3g} at the detector's ends to {profile.min():.3g} behind the log, as counts "
            f"and transmissions do, and line integrals rise: {take}",
        )
    if level < LEAST_AIR:
        raise UnreadableScan(
            "contradiction",
            f"the values are {level:.3g} at the detector's ends, where air has nearly 0, as where counts were not "
            f"divided by the flat field: {take}",
        )
