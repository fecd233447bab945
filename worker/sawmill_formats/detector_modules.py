"""Modules of a line detector as NXdetector_module groups state them (manual.nexusformat.org).

A group names its part of the images (`data_origin`, `data_size`), where its first cell begins (`module_offset` along a
`vector`), and how its cells follow one another (`fast_pixel_direction`). The beam runs along z.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sawmill_vocabulary import DetectorModule

CLASS, ORIGIN, SIZE, OFFSET, STEP = (
    "NXdetector_module",
    "data_origin",
    "data_size",
    "module_offset",
    "fast_pixel_direction",
)
MOST_MODULES, LARGEST_GAP_MM, LARGEST_KINK_RAD = 64, 1000.0, 0.5
# A module's first cell is off the neighbour's line by at most this, and the last cell off the plane of the beam.
LARGEST_STEP_MM = 0.05
# Relative difference of two equal distances.
SAME = 1e-4
ACROSS, _, BEAM = np.eye(3)

Vector = NDArray[np.float64]


class ModulesUnusable(Exception):  # noqa: N818 - it names the thing that cannot be used
    """Modules without gaps and kinks that can be used; the message says why."""


@dataclass(frozen=True, eq=False)
class PlacedModule:
    """A module in the laboratory."""

    first: int  # its first cell, and the number of cells
    cells: int
    start_mm: Vector  # (3,): where its first cell begins, and from each cell to the next
    step_mm: Vector  # (3,)

    @property
    def end_mm(self) -> Vector:
        """Where its last cell ends."""
        return self.start_mm + self.cells * self.step_mm

    @property
    def pitch_mm(self) -> float:
        """Distance between its cells."""
        return float(np.linalg.norm(self.step_mm))

    @property
    def way(self) -> Vector:
        """Direction of the line."""
        return self.step_mm / self.pitch_mm


def translation(length_mm: float, vector: object, name: str) -> Vector:
    """Return a length along the vector that a file states for it, (3,) mm."""
    way = np.asarray(vector)
    if way.shape != (3,) or way.dtype.kind not in "iuf" or not np.isfinite(way).all() or not way.any():
        raise ModulesUnusable(f"the {name} of one is not along a vector")
    return length_mm * way / np.linalg.norm(way)


def placed_modules(modules: Sequence[DetectorModule], cells: int, pitch_mm: float) -> list[PlacedModule]:
    """Place all modules of a detector, the first included, one after another from the first cell on."""
    borders = [0, *(module.first_cell for module in modules), cells]
    tilts = np.cumsum([0.0, *(module.kink_rad for module in modules)])
    tilts -= tilts[_middle(borders, cells)]
    steps = [pitch_mm * (math.cos(tilt) * ACROSS + math.sin(tilt) * BEAM) for tilt in tilts]
    placed = [PlacedModule(0, borders[1], np.zeros(3), steps[0])]
    for module, end, before, step in zip(modules, borders[2:], steps, steps[1:], strict=False):
        start_mm = placed[-1].end_mm + module.gap_mm / pitch_mm * (before if module.first_cell > cells // 2 else step)
        placed.append(PlacedModule(module.first_cell, end - module.first_cell, start_mm, step))
    return placed


def modules_after_first(
    placed: Sequence[PlacedModule], cells: int, pitch_mm: float | None
) -> tuple[DetectorModule, ...]:
    """Return gap and kink of every module against the one before."""
    if len(placed) > MOST_MODULES:
        raise ModulesUnusable(f"there are more than {MOST_MODULES}")
    ordered = sorted(placed, key=lambda one: one.first)
    _check_cells(ordered, cells, pitch_mm)
    middle = ordered[_middle([one.first for one in ordered], cells)]
    across = middle.way - (middle.way @ BEAM) * BEAM
    if np.linalg.norm(across) < SAME:
        raise ModulesUnusable("their cells follow one another along z, the direction of the beam")
    across /= np.linalg.norm(across)
    return tuple(_against(before, one, across, cells) for before, one in pairwise(ordered))


def _middle(first_cells: Sequence[int], cells: int) -> int:
    """Return which module holds the detector's middle."""
    return sum(first <= cells // 2 for first in first_cells) - 1


def _check_cells(ordered: Sequence[PlacedModule], cells: int, pitch_mm: float | None) -> None:
    end = 0
    for one in ordered:
        if one.first != end:
            raise ModulesUnusable(f"one begins at cell {one.first}, and the one before ends at cell {end}")
        if pitch_mm is None or abs(one.pitch_mm - pitch_mm) > SAME * pitch_mm:
            of_file = "the file states none" if pitch_mm is None else f"x_pixel_size is {pitch_mm:g} mm"
            raise ModulesUnusable(f"their cells are {one.pitch_mm:g} mm apart by {STEP}, and {of_file}")
        end += one.cells
    if end != cells:
        raise ModulesUnusable(f"they have {end} cells, and the images have {cells}")


def _against(before: PlacedModule, one: PlacedModule, across: Vector, cells: int) -> DetectorModule:
    apart, nearer = one.start_mm - before.end_mm, before if one.first > cells // 2 else one
    gap_mm = float(apart @ nearer.way)
    kink_rad = math.remainder(_tilt(one.way, across) - _tilt(before.way, across), math.tau)
    if not (abs(gap_mm) <= LARGEST_GAP_MM and abs(kink_rad) <= LARGEST_KINK_RAD):
        raise ModulesUnusable(
            f"at cell {one.first} they are {gap_mm:g} mm and {math.degrees(kink_rad):g} degrees apart"
        )
    off_plane = one.cells * float(np.cross(BEAM, across) @ one.step_mm)
    off_line = float(np.linalg.norm(apart - gap_mm * nearer.way))
    if max(abs(off_plane), off_line) > LARGEST_STEP_MM:
        raise ModulesUnusable(
            f"at cell {one.first} they are {max(abs(off_plane), off_line):.3g} mm out of line, and only gaps along the "
            "line and angles in the plane of the beam are used"
        )
    return DetectorModule(one.first, gap_mm, kink_rad)


def _tilt(way: Vector, across: Vector) -> float:
    """Return the angle of a line from the direction across the beam towards the beam's."""
    return math.atan2(float(way @ BEAM), float(way @ across))
