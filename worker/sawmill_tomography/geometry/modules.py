"""Line detectors made of modules: each module is one flat line (docs/look-up/conventions.md#modules).

The source frame describes the module that holds the detector's middle. Every other module has the same cells with a
source frame of its own: a gap moves the module along the line before, a kink turns it about its end.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FloatArray, Scanner, SourceFrame, cell_centres_mm
from sawmill_vocabulary import DetectorModule

Lines = TypeVar("Lines", NDArray[np.float32], NDArray[np.float64])


class ModuleLine(NamedTuple):
    """One module as a flat line detector."""

    first: int  # its cells are first to end - 1
    end: int
    sdd_mm: float  # SDD, u_c and tau of the line; the coordinate u of the cells is the one of a detector without gaps
    cor_column_mm: float
    tilt_rad: float
    sdd_slopes: tuple[float, float, float] = (1.0, 0.0, 0.0)  # (3,) tuples
    column_slopes: tuple[float, float, float] = (0.0, 1.0, 0.0)  # (3,) tuples


def module_lines(
    modules: Sequence[DetectorModule], cells: int, first_border_mm: float, pitch_mm: float, frame: SourceFrame
) -> list[ModuleLine]:
    """Return the line of every module, in the order of the cells."""
    borders = [0, *(module.first_cell for module in modules), cells]
    middle = sum(border <= cells // 2 for border in borders[1:-1])
    lines = {middle: _line(borders, middle, frame, frame.cor_column_mm, 0.0, 0.0, frame.tilt_rad)}
    for step in (1, -1):
        # The end of the module before, as a point of the frame with the source at (0, 0) and the detector along y.
        tilt = frame.tilt_rad
        u, x, y = frame.cor_column_mm, 0.0, frame.source_to_detector_mm
        for number in range(middle + step, len(modules) + 1 if step > 0 else -1, step):
            module = modules[max(number, number - step) - 1]
            border = first_border_mm + pitch_mm * module.first_cell
            along = border - u + step * module.gap_mm
            x, y = x + along * math.cos(tilt), y + along * math.sin(tilt)
            u, tilt = border, tilt + step * module.kink_rad
            lines[number] = _line(borders, number, frame, u, x, y - frame.source_to_detector_mm, tilt)
    return [lines[number] for number in sorted(lines)]


def _line(
    borders: Sequence[int], number: int, frame: SourceFrame, u: float, x: float, y: float, tilt: float
) -> ModuleLine:
    """Return the line through a point, given from the foot of the ray through the COR, at which the coordinate is u."""
    cosine, tangent = math.cos(tilt), math.tan(tilt)
    # The point moves with u_c against the direction of the whole detector, and turns with tau about the foot.
    by_column = (-math.cos(frame.tilt_rad), -math.sin(frame.tilt_rad))
    by_tilt = (-y, x)
    return ModuleLine(
        borders[number],
        borders[number + 1],
        frame.source_to_detector_mm + y - x * tangent,
        u - x / cosine,
        tilt,
        (
            1.0,
            by_column[1] - tangent * by_column[0],
            by_tilt[1] - tangent * by_tilt[0] - x / cosine**2,
        ),
        (0.0, -by_column[0] / cosine, -by_tilt[0] / cosine - x * tangent / cosine),
    )


def lines_of(scanner: Scanner, frame: SourceFrame) -> list[ModuleLine]:
    """Return the lines of a scanner's modules."""
    cells, pitch = scanner.num_detector_pixels, scanner.detector_pitch_mm
    return module_lines(scanner.detector_modules, cells, -0.5 * cells * pitch, pitch, frame)


def cell_points(scanner: Scanner, frame: SourceFrame) -> FloatArray:
    """Return each cell's centre (cells, 2), mm, from the source: across and along the ray through the COR."""
    u = cell_centres_mm(scanner)
    points = np.empty((u.size, 2))
    for line in lines_of(scanner, frame):
        w = u[line.first : line.end] - line.cor_column_mm
        points[line.first : line.end, 0] = w * math.cos(line.tilt_rad)
        points[line.first : line.end, 1] = line.sdd_mm + w * math.sin(line.tilt_rad)
    return points


def flat_centres_mm(scanner: Scanner, frame: SourceFrame) -> FloatArray:
    """Return the coordinate u, (cells,) mm, at which each cell's ray meets the line of the middle module."""
    across, along = cell_points(scanner, frame).T
    sine, cosine = math.sin(frame.tilt_rad), math.cos(frame.tilt_rad)
    flat: FloatArray = frame.cor_column_mm + frame.source_to_detector_mm * across / (along * cosine - across * sine)
    return flat


@dataclass(frozen=True, eq=False)
class FlatDetector:
    """Interpolation from a detector of modules to cells at equal distances on the line of the middle module.

    Values come from the cubic polynomial through four cells, also across a gap. Linear interpolation would make the
    curved shadow of a log too light there, in every view alike.
    """

    cells: NDArray[np.intp]  # (4, cells) int: cells of the detector of modules from which each cell is interpolated
    weights: FloatArray  # (4, cells)
    across_gaps: NDArray[np.bool_]  # (cells,) bool

    @classmethod
    def of(cls, scanner: Scanner, frame: SourceFrame) -> "FlatDetector":
        """Return the interpolation for a scanner's modules at a source frame."""
        count, wanted = scanner.num_detector_pixels, cell_centres_mm(scanner)
        seen = flat_centres_mm(scanner, frame)
        before = np.clip(np.searchsorted(seen, wanted, side="right") - 1, 0, count - 2)
        cells = np.clip(before - 1, 0, count - 4) + np.arange(4)[:, None]
        module = np.searchsorted([one.first_cell for one in scanner.detector_modules], np.arange(count), side="right")
        weights = _through(seen[cells], np.clip(wanted, seen[0], seen[-1]))
        return cls(cells, weights, module[before] != module[before + 1])

    def resampled(self, lines: Lines) -> Lines:
        """Interpolate values (..., cells)."""
        weights = self.weights.astype(lines.dtype)
        flat: Lines = np.multiply(lines[..., self.cells[0]], weights[0])
        for cells, weight in zip(self.cells[1:], weights[1:], strict=True):
            flat += lines[..., cells] * weight
        return flat


def _through(nodes: FloatArray, at: FloatArray) -> FloatArray:
    """Return the weights (nodes, points) of values at nodes (nodes, points) in the polynomial through them."""
    weights = np.ones_like(nodes)
    for one, other in permutations(range(len(nodes)), 2):
        weights[one] *= (at - nodes[other]) / (nodes[one] - nodes[other])
    return weights
