"""Cells and views of a log's scan without a usable signal, those at the detector's ends included, and its metal."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from numba import get_num_threads, set_num_threads
from numpy.typing import NDArray

from sawmill_tomography.drift.change import DriftError
from sawmill_tomography.geometry.geometry import FanBeamGeometry, FloatArray, Scanner, SourceFrame
from sawmill_tomography.reconstruction.metal import MOST_SAMPLES, MetalSearch
from sawmill_tomography.reconstruction.object_extent import object_radius_mm
from sawmill_tomography.sinograms.screening import Screening, screen

# Cells at either end of the detector are compared with this number of the next ones: `screen` compares a cell with its
# neighbours on both sides, which an end does not have.
END_CELLS, BESIDE = 4, 8
# A faulty cell in air departs from those cells by more than this number of their standard deviations, and by more than
# this share of the range (air.EDGE_SHARE): the flat field may slope.
DEPARTS, SHARE = 4.0, 0.003


@dataclass(frozen=True)
class LogScreening(Screening):
    """The usable parts of a log's sinogram; `hidden` samples see metal."""

    @property
    def adjustments(self) -> tuple[str, ...]:
        """Sentences on cells, views and samples that were left out."""
        if self.hidden is None:
            return super().adjustments
        return (*super().adjustments, f"metal in the log: {self.hidden.mean():.1%} of the samples were left out")


def screen_log(scanner: Scanner, sinogram: FloatArray, angles_rad: FloatArray, start: SourceFrame) -> LogScreening:
    """Screen a log's scan for metal, then for cells and views without a usable signal.

    Rays through nails are starved and hardened, and differently from either side.

    `sinogram` (views, detector): line integrals. `angles_rad` (views,): view angles in the calibrated sense of
    rotation.
    """
    screening = _screen_ends(sinogram)
    lines = screening.bridged(sinogram).astype(np.float32)
    fan = fan_for_images(scanner, angles_rad, start)
    with one_thread():
        search = MetalSearch.of(fan, object_radius_mm(fan, lines))
        metal = None if search is None else search.find(lines[None])[0]
    if metal is None:
        return LogScreening(screening.cells, screening.views)
    if metal.is_too_much:
        raise DriftError(
            "metal-in-log",
            f"metal in the log covers {metal.trace.mean():.0%} of the samples, and {MOST_SAMPLES:.0%} may be left out: "
            "take rows without metal, or another log",
        )
    # A view across a long nail looks corrupt, and so do cells at the edges of a nail's shadow.
    again = _screen_ends(replace(screening, cells=np.ones_like(screening.cells), hidden=metal.trace).bridged(sinogram))
    return LogScreening(screening.cells | again.cells, again.views, metal.trace)


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep kernels to one thread: on the small images of a check two take longer, as they wait for each other."""
    threads = get_num_threads()
    set_num_threads(1)
    try:
        yield
    finally:
        set_num_threads(threads)


def fan_for_images(scanner: Scanner, angles_rad: FloatArray, start: SourceFrame) -> FanBeamGeometry:
    """Return a geometry for images of the log: any R gives a usable one, as a shadow's place does not depend on it."""
    own = replace(scanner, source_to_cor_mm=start.source_distance_mm)
    return FanBeamGeometry(own, start.theta(start.source_distance_mm), angles_rad)


def _screen_ends(sinogram: FloatArray) -> Screening:
    """Screen a log's scan (`screen`), including faulty cells at the detector's ends that look like a cut-off log."""
    screening = screen(sinogram)
    lines = screening.bridged(sinogram)[screening.views]
    # The range as `find_air` defines it.
    least = SHARE * float(np.ptp(np.quantile(lines[:: max(1, len(lines) // 64)], [0.005, 0.995])))
    cells = screening.cells.copy()
    cells[:END_CELLS] &= _sound(lines[:, : END_CELLS + BESIDE], least)
    cells[-END_CELLS:] &= _sound(lines[:, : -END_CELLS - BESIDE - 1 : -1], least)[::-1]
    return replace(screening, cells=cells)


def _sound(end: FloatArray, least: float) -> NDArray[np.bool_]:
    """Return which of the outermost `END_CELLS` cells have the level of their neighbours, for an end (views, cells)."""
    beside = end[:, END_CELLS:]
    level = beside.mean(axis=1, keepdims=True)
    departure = np.sqrt(np.mean((end[:, :END_CELLS] - level) ** 2, axis=0))
    return np.asarray(departure <= max(DEPARTS * float(np.sqrt(np.mean((beside - level) ** 2))), least))
