"""From detector counts to line integrals: flat and dark fields and the Beer-Lambert law."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sawmill_worker.tomography.bridging import bridge

Stack = NDArray[np.float32]

# A transmission below this is no measurement but a starved detector: the line integral is cut off here, at 13.8.
LEAST_TRANSMISSION = 1e-6
# More dead cells than this share of the detector cannot be bridged from their neighbours.
MOST_DEAD = 0.2


class CountsError(ValueError):
    """Counts that cannot become line integrals; the message says why."""


@dataclass(frozen=True, eq=False)
class Exposure:
    """Each detector cell's dark signal and gain, from flat and dark fields.

    Attributes
    ----------
    dark : (rows, detector) float32
        Mean dark field, in counts.
    level : (rows, detector) float32
        Mean flat minus mean dark, in counts; 1 in dead cells.
    dead : (rows, detector) bool
        Cells whose flat is not above their dark.
    """

    dark: NDArray[np.float32]
    level: NDArray[np.float32]
    dead: NDArray[np.bool_]

    @classmethod
    def of(cls, flats: Stack, darks: Stack | None) -> "Exposure":
        """From flats and darks (fields, rows, detector).

        Raises
        ------
        CountsError
            If too many cells are dead.
        """
        dark = np.zeros(flats.shape[1:]) if darks is None else darks.mean(axis=0, dtype=np.float64)
        air = flats.mean(axis=0, dtype=np.float64) - dark
        dead = air <= 0.0
        if dead.mean() > MOST_DEAD:
            raise CountsError(
                f"{int(dead.sum())} of {dead.size} detector cells have a flat field that is not above their dark "
                "field: check that flats and darks were not exchanged"
            )
        return cls(dark.astype(np.float32), np.where(dead, 1.0, air).astype(np.float32), dead)

    def same_in_all_rows(self) -> "Exposure":
        """With the mean dark signal and gain of each cell's rows: what one row differs by stays in the line integrals.

        Where views lost rows it is not known yet which row of the detector a sample is of. That difference then moves
        with the log, whereas the gain of a wrong row would stand still in it.
        """
        alive = ~self.dead
        level = np.where(alive, self.level, 0.0).sum(axis=0) / np.maximum(alive.sum(axis=0), 1)
        dead = np.broadcast_to(level <= 0.0, self.dead.shape)
        dark = np.broadcast_to(self.dark.mean(axis=0), self.dark.shape)
        return Exposure(dark, np.where(dead, np.float32(1.0), level.astype(np.float32)), dead)

    @property
    def air_level(self) -> NDArray[np.float32]:
        """(rows, detector) float32, in counts; 0 in dead cells. With it the counts can be recovered."""
        return np.where(self.dead, np.float32(0.0), self.level)

    def to_line_integrals(self, counts: Stack, first_row: int = 0) -> int:
        """Counts (views, rows, detector) to -ln((counts - dark) / (flat - dark)), dimensionless, in place.

        Dead cells are bridged from their neighbours along the detector; starved samples (counts at or below the dark)
        are cut off at the least transmission. Missing samples, NaN, stay missing.

        Parameters
        ----------
        counts : (views, rows, detector) float32
            All rows of the detector, or some from `first_row` on.

        Returns
        -------
        int
            The number of starved samples.

        Raises
        ------
        CountsError
            Where all cells of a row are dead.
        """
        rows = slice(first_row, first_row + counts.shape[1])
        dead = self.dead[rows]
        counts -= self.dark[rows]
        counts /= self.level[rows]
        starved = int(np.count_nonzero((counts < LEAST_TRANSMISSION) & ~dead))
        np.maximum(counts, LEAST_TRANSMISSION, out=counts)
        np.log(counts, out=counts)
        np.negative(counts, out=counts)
        for row in np.flatnonzero(dead.any(axis=1)):
            if dead[row].all():
                raise CountsError(f"every cell of detector row {first_row + row} is dead: leave the row out")
            bridge(counts[:, row], dead[row])
        return starved

    def remarks(self, starved: int) -> tuple[str, ...]:
        """What was done; `starved` is the number of samples without signal."""
        remarks = ["counts to line integrals by -ln((counts - dark) / (flat - dark))"]
        if starved:
            remarks.append(f"{starved} samples without signal cut off at a line integral of 13.8")
        if self.dead.any():
            remarks.append(f"{int(self.dead.sum())} dead detector cells bridged from their neighbours")
        return tuple(remarks)


@dataclass(frozen=True)
class LineIntegrals:
    """A stack of line integrals.

    Attributes
    ----------
    stack : (views, rows, detector) float32
        Dimensionless.
    air_level : (rows, detector) float32
        In counts, as `Exposure.air_level`.
    remarks : tuple of str
        What was done.
    """

    stack: Stack
    air_level: Stack
    remarks: tuple[str, ...]


def line_integrals(counts: Stack, flats: Stack, darks: Stack | None) -> LineIntegrals:
    """Line integrals of counts (views, rows, detector) with flats and darks (fields, rows, detector)."""
    exposure, stack = Exposure.of(flats, darks), counts.astype(np.float32)
    starved = exposure.to_line_integrals(stack)
    return LineIntegrals(stack, exposure.air_level, exposure.remarks(starved))
