"""Line integrals from detector counts: flat and dark fields and the Beer-Lambert law."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.sinograms.present_rows import bridge
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.reading_messages import PreparingMessage

Stack = NDArray[np.float32]

# A transmission below this is not measured, the detector is starved: the line integral is cut off here, at 13.8.
LEAST_TRANSMISSION = 1e-6
# If a larger share of the samples has no signal, the data are not counts: a detector sees air, or through the log. Deep
# shadows of few quanta over half of the detector leave a third without signal (tests/tomography/preparing).
MOST_STARVED = 0.9
# More dead cells than this share of the detector cannot be bridged from their neighbours.
MOST_DEAD = 0.2
# Flats saturate if this share of their samples has their largest value. It must be a converter's largest value, or be
# this many times as frequent as the value below it, at least the third number of times: noise piles up nowhere else.
LARGEST_VALUES = (255.0, 1023.0, 4095.0, 16383.0, 65535.0)
PLATEAU, PILED_UP, FEWEST = 0.01, 3.0, 20
# A cell is saturated if more than this share of its flats, or of the views, has the largest value: with a smaller share
# the mean flat is too small by no more than a twentieth of the flats' noise.
SATURATED = 0.1
# Remarks that a calibration repeats.
SATURATION = (
    PreparingMessage.SATURATED_FLATS,
    PreparingMessage.SATURATED_FLATS_BRIDGED,
    PreparingMessage.SATURATED_SAMPLES,
)


class CountsError(ValueError):
    """Counts that cannot become line integrals; the message gives the reason."""


@dataclass(frozen=True, eq=False)
class Exposure:
    """Dark signal and gain of each detector cell, from flat and dark fields."""

    dark: NDArray[np.float32]  # (rows, detector) float32: mean dark field, in counts
    level: NDArray[np.float32]  # (rows, detector) float32: mean flat minus mean dark, in counts; 1 in dead cells
    # (rows, detector) bool: cells whose flat is not above their dark; also cells whose flat is saturated, if these are
    # few
    dead: NDArray[np.bool_]
    saturated: NDArray[np.bool_]  # (rows, detector) bool: cells whose flats have the largest count
    largest: float = math.inf  # largest count of the detector, as far as the flats show; infinity if unknown

    @classmethod
    def of(cls, flats: Stack, darks: Stack | None) -> "Exposure":
        """Compute the exposure from flats and darks (fields, rows, detector).

        Raises
        ------
        CountsError
            If too many cells are dead.
        """
        dark = np.zeros(flats.shape[1:]) if darks is None else darks.mean(axis=0, dtype=np.float64)
        air = flats.mean(axis=0, dtype=np.float64) - dark
        dead = air <= 0.0
        if dead.mean() > MOST_DEAD:
            row, cell = (int(i) for i in np.unravel_index(np.argmax(dead), dead.shape))
            raise CountsError(
                f"{int(dead.sum())} of {dead.size} detector cells have a flat field that is not above their dark "
                f"field, as in row {row}, cell {cell} with a mean flat of {air[row, cell] + dark[row, cell]:g} and a "
                f"mean dark of {dark[row, cell]:g} counts; at most {MOST_DEAD:.0%} may: check that flats and darks "
                "were not exchanged"
            )
        largest, saturated = _saturation(flats)
        saturated &= ~dead
        bridged = dead | saturated
        if bridged.mean() <= MOST_DEAD:
            dead = bridged
        return cls(dark.astype(np.float32), np.where(dead, 1.0, air).astype(np.float32), dead, saturated, largest)

    def same_in_all_rows(self) -> "Exposure":
        """Return the mean dark signal and gain over each cell's rows: a row's deviation stays in the line integrals.

        Where views lost rows it is not known yet which row of the detector a sample comes from. The deviation then
        moves with the log, whereas the gain of a wrong row would stay in place.
        """
        alive = ~self.dead
        level = np.where(alive, self.level, 0.0).sum(axis=0) / np.maximum(alive.sum(axis=0), 1)
        dead = np.broadcast_to(level <= 0.0, self.dead.shape)
        dark = np.broadcast_to(self.dark.mean(axis=0), self.dark.shape)
        return replace(self, dark=dark, level=np.where(dead, np.float32(1.0), level.astype(np.float32)), dead=dead)

    @property
    def air_level(self) -> NDArray[np.float32]:
        """Air level (rows, detector) float32, in counts; 0 in dead cells. The counts can be recovered from it."""
        return np.where(self.dead, np.float32(0.0), self.level)

    def at_largest(self, counts: Stack) -> NDArray[np.bool_]:
        """Return which samples (views, rows, detector) have the detector's largest value."""
        return np.asarray(counts == np.float32(self.largest))

    def saturated_samples(self, at_largest: NDArray[np.intp], brightest: float) -> NDArray[np.intp]:
        """Return the number of views in which each cell (rows, detector) is saturated.

        Parameters
        ----------
        at_largest : (rows, detector) int
            Number of views in which each cell has the largest value that the flats suggest.
        brightest
            Largest count of the scan. The flats suggested too small a value where it is larger.
        """
        return np.zeros_like(at_largest) if brightest > self.largest else at_largest

    def saturated_share(self, saturated_views: NDArray[np.intp], views: int) -> float:
        """Compute the share of the cells (rows, detector) that are saturated in the flats or in the views."""
        return float((self.saturated | (saturated_views > SATURATED * views)).mean())

    def to_line_integrals(self, counts: Stack, first_row: int = 0) -> NDArray[np.intp]:
        """Convert counts (views, rows, detector) to -ln((counts - dark) / (flat - dark)), dimensionless, in place.

        Dead cells are bridged from their neighbours along the detector; starved samples (counts at or below the dark)
        are cut off at the least transmission. Missing samples, NaN, stay missing.

        Parameters
        ----------
        counts : (views, rows, detector) float32
            All rows of the detector, or some from `first_row` on.

        Returns
        -------
        (views,) int
            Number of starved samples of each view.

        Raises
        ------
        CountsError
            If all cells of a row are dead.
        """
        rows = slice(first_row, first_row + counts.shape[1])
        dead = self.dead[rows]
        counts -= self.dark[rows]
        counts /= self.level[rows]
        starved: NDArray[np.intp] = np.count_nonzero((counts < LEAST_TRANSMISSION) & ~dead, axis=(1, 2))
        np.maximum(counts, LEAST_TRANSMISSION, out=counts)
        np.log(counts, out=counts)
        np.negative(counts, out=counts)
        for row in np.flatnonzero(dead.any(axis=1)):
            if dead[row].all():
                raise CountsError(f"every cell of detector row {first_row + row} is dead: leave the row out")
            bridge(counts[:, row], dead[row])
        return starved

    def check_signal(self, starved: int, samples: int) -> None:
        """Refuse counts of which hardly a sample is above the dark field.

        Raises
        ------
        CountsError
            If more samples are starved than a log can starve.
        """
        if starved > MOST_STARVED * samples:
            raise CountsError(
                f"{starved} of {samples} samples of the scan are not above the dark field (on average "
                f"{self.dark.mean():g} counts, the flat fields {self.level.mean():g} above it); at most "
                f"{MOST_STARVED:.0%} may: check that the data are counts, and which fields belong to them"
            )

    def remarks(self, starved: int, saturated: int = 0) -> tuple[Reason, ...]:
        """Return the corrections made, with the numbers of samples without signal and with the largest count."""
        remarks: list[Reason] = [PreparingMessage.LINE_INTEGRALS()]
        if starved:
            remarks.append(PreparingMessage.NO_SIGNAL(samples=starved))
        dead = int((self.dead & ~self.saturated).sum())
        if dead:
            remarks.append(PreparingMessage.DEAD_CELLS(cells=dead))
        if self.saturated.any():
            bridged, left = PreparingMessage.SATURATED_FLATS_BRIDGED, PreparingMessage.SATURATED_FLATS
            message = bridged if (self.dead & self.saturated).any() else left
            remarks.append(message(saturated=int(self.saturated.sum()), cells=self.dead.size, largest=self.largest))
        elif saturated:
            remarks.append(PreparingMessage.SATURATED_SAMPLES(samples=saturated, largest=self.largest))
        return tuple(remarks)


def _saturation(flats: Stack) -> tuple[float, NDArray[np.bool_]]:
    """Return the detector's largest count, and the cells (rows, detector) whose flats (fields, ...) have it."""
    top = float(flats.max())
    has_it, below = flats == top, flats[flats < top]
    number = int(np.count_nonzero(has_it))
    second = int(np.count_nonzero(flats == below.max())) if below.size else number
    if number >= PLATEAU * flats.size and (top in LARGEST_VALUES or number >= max(PILED_UP * second, FEWEST)):
        return top, has_it.mean(axis=0) > SATURATED
    return next((value for value in LARGEST_VALUES if value >= top), math.inf), np.zeros(flats.shape[1:], bool)
