"""Shapes of line detectors: modules and arcs as flat pieces (docs/look-up/conventions.md#modules), and their cells.

From a point source only the direction of a ray counts. A detector of any shape is described by where the rays to the
borders of its cells cross one flat line, the source frame's: `flat_borders_mm`. A new shape is a case of
`detector_lines`; whatever projects, reconstructs or checks drift takes the places of the borders and knows no shape.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, permutations
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sawmill_vocabulary import DetectorModule, Scanner, SourceFrame

FloatArray = NDArray[np.float64]
# Half waves over the detector of the longest wave by which cells lie at unequal distances.
FIRST_WAVE = 2
Lines = TypeVar("Lines", NDArray[np.float32], NDArray[np.float64])


def cell_borders_mm(scanner: Scanner) -> FloatArray:
    """Return the coordinate u of the cells' borders on a flat detector, (cells + 1,) mm."""
    n = scanner.num_detector_pixels
    return (np.arange(n + 1, dtype=np.float64) - 0.5 * n) * scanner.detector_pitch_mm


def cell_centres_mm(scanner: Scanner) -> FloatArray:
    """Return u_m = (m + 1/2 - n_D/2) pitch of each cell m, (cells,) mm."""
    n = scanner.num_detector_pixels
    return (np.arange(n, dtype=np.float64) + 0.5 - 0.5 * n) * scanner.detector_pitch_mm


class DetectorLines(NamedTuple):
    """The flat pieces of a detector, in the order of the cells: each is a flat line detector."""

    first: NDArray[np.intp]  # (lines,) int: the cells of a piece are first to end - 1
    end: NDArray[np.intp]
    sdd_mm: FloatArray  # (lines,): SDD, u_c and tau of each line
    cor_column_mm: FloatArray  # u of the cells is the coordinate of a flat detector without gaps
    tilt_rad: FloatArray
    sdd_slopes: FloatArray  # (lines, 3): derivatives of a line's SDD and u_c by SDD, u_c and tau of the source frame
    column_slopes: FloatArray


def detector_lines(
    modules: Sequence[DetectorModule],
    arc_radius_mm: float | None,
    cells: int,
    first_border_mm: float,
    pitch_mm: float,
    frame: SourceFrame,
    *,
    piece_cells: int = 1,
    waves_mm: Sequence[float] = (),
) -> DetectorLines:
    """Return the flat pieces: a module, or on an arc `piece_cells` cells, which touch it at their middle.

    With waves, which shift the cells along the line, each cell is a piece.

    The source frame describes the module that holds the detector's middle, or the line that touches the arc there. A
    gap moves a module along the module before, a kink turns it about the end of that module.
    """
    borders = [0, *(module.first_cell for module in modules), cells]
    middle = sum(border <= cells // 2 for border in borders[1:-1])
    # Across and along the ray through the COR as complex numbers: a module is its arc, turned by tilt, from an origin.
    placed = {middle: (-frame.cor_column_mm * np.exp(1j * frame.tilt_rad), frame.tilt_rad)}
    for step in (1, -1):
        origin, tilt = placed[middle]
        for number in range(middle + step, len(modules) + 1 if step > 0 else -1, step):
            module = modules[max(number, number - step) - 1]
            joint, turn = _on_arc(first_border_mm + pitch_mm * module.first_cell, arc_radius_mm)
            origin += joint * np.exp(1j * tilt) + step * module.gap_mm * np.exp(1j * (tilt - turn))
            tilt += step * module.kink_rad
            origin -= joint * np.exp(1j * tilt)
            placed[number] = (origin, tilt)
    pieces = []
    for number, (first, end) in enumerate(pairwise(borders)):
        origin, tilt = placed[number]
        whole = arc_radius_mm is None and not waves_mm
        starts = np.arange(first, end, end - first if whole else 1 if waves_mm else piece_cells)
        ends = np.append(starts[1:], end)
        at = np.full(1, frame.cor_column_mm) if whole else first_border_mm + 0.5 * pitch_mm * (starts + ends)
        point, turn = _on_arc(at + waves(waves_mm, starts, cells) if waves_mm else at, arc_radius_mm)
        pieces.append(_lines(starts, ends, frame, at, origin + point * np.exp(1j * tilt), tilt - turn))
    return DetectorLines(*map(np.concatenate, zip(*pieces, strict=True)))


def waves(sizes_mm: Sequence[float], at_cells: NDArray[np.intp], cells: int) -> FloatArray:
    """Return how far some of a detector's cells lie from equal distances, mm."""
    return np.asarray(sizes_mm) @ wave_shapes(len(sizes_mm), at_cells, cells)


def wave_shapes(count: int, at_cells: NDArray[np.intp], cells: int) -> FloatArray:
    """Return the shapes of the first waves at some cells, (count, cells): cosines of two halves over the detector up.

    A constant is u_c, and half a wave hardly differs from another distance of the source.
    """
    order = np.arange(FIRST_WAVE, FIRST_WAVE + count)
    return np.asarray(np.cos(math.pi / cells * np.multiply.outer(order, at_cells + 0.5)))


def _on_arc(at: ArrayLike, radius_mm: float | None) -> tuple[NDArray[np.complex128], FloatArray]:
    """Return the point at a length of arc from where it touches the line, as a complex number, and the arc's turn."""
    turn = np.asarray(at, np.float64) / (radius_mm or math.inf)
    return np.asarray(at, complex) if radius_mm is None else 1j * radius_mm * (np.exp(-1j * turn) - 1.0), turn


def _lines(
    first: NDArray[np.intp],
    end: NDArray[np.intp],
    frame: SourceFrame,
    u: FloatArray,
    point: NDArray[np.complex128],
    tilt: FloatArray,
) -> DetectorLines:
    """Return lines through points, given from the foot of the ray through the COR, at which the coordinate is u."""
    x, y, cosine, tangent, one = point.real, point.imag, np.cos(tilt), np.tan(tilt), np.ones_like(tilt)
    # The points move with u_c against the direction of the whole detector, and turn with tau about the foot.
    across, along = -math.cos(frame.tilt_rad), -math.sin(frame.tilt_rad)
    return DetectorLines(
        first,
        end,
        frame.source_to_detector_mm + y - x * tangent,
        u - x / cosine,
        tilt,
        np.stack([one, along - tangent * across, x + tangent * y - x / cosine**2], -1),
        np.stack([0.0 * one, -across / cosine, y / cosine - x * tangent / cosine], -1),
    )


def lines_of(scanner: Scanner, frame: SourceFrame) -> DetectorLines:
    """Return the flat pieces of a scanner's detector."""
    cells, pitch = scanner.num_detector_pixels, scanner.detector_pitch_mm
    return detector_lines(
        scanner.detector_modules,
        scanner.detector_arc_radius_mm,
        cells,
        -0.5 * cells * pitch,
        pitch,
        frame,
        waves_mm=scanner.detector_waves_mm,
    )


def cell_points(scanner: Scanner, frame: SourceFrame, at_cells: float = 0.0) -> FloatArray:
    """Return each cell's centre, or a point this share of a cell beyond it, from the source, (cells, 2) mm.

    The coordinates are across and along the ray through the COR.
    """
    lines = lines_of(scanner, frame)
    column, sdd, tilt = np.repeat([lines.cor_column_mm, lines.sdd_mm, lines.tilt_rad], lines.end - lines.first, axis=1)
    w = cell_centres_mm(scanner) + at_cells * scanner.detector_pitch_mm - column
    return np.stack([w * np.cos(tilt), sdd + w * np.sin(tilt)], -1)


def flat_borders_mm(scanner: Scanner, frame: SourceFrame) -> FloatArray:
    """Return the coordinate u at which the rays to each cell's borders meet the source frame's line, (cells, 2) mm."""
    across, along = np.stack([cell_points(scanner, frame, at) for at in (-0.5, 0.5)]).transpose(2, 1, 0)
    sine, cosine = math.sin(frame.tilt_rad), math.cos(frame.tilt_rad)
    return np.asarray(frame.cor_column_mm + frame.source_to_detector_mm * across / (along * cosine - across * sine))


@dataclass(frozen=True, eq=False)
class FlatDetector:
    """Interpolation from a detector of any shape to cells at equal distances on the source frame's line.

    Values come from the cubic polynomial through four cells, also across a gap. Linear interpolation would make the
    curved shadow of a log too light there, in every view alike.
    """

    cells: NDArray[np.intp]  # (4, cells) int: cells of the detector from which each cell is interpolated
    weights: FloatArray  # (4, cells)
    across_gaps: NDArray[np.bool_]  # (cells,) bool

    @classmethod
    def of(cls, borders_mm: FloatArray, scanner: Scanner) -> "FlatDetector":
        """Return the interpolation from cells with borders (cells, 2), mm, to the scanner's cells on a flat line."""
        count, wanted, seen = len(borders_mm), cell_centres_mm(scanner), borders_mm.mean(axis=1)
        before = np.clip(np.searchsorted(seen, wanted, side="right") - 1, 0, count - 2)
        cells = np.clip(before - 1, 0, count - 4) + np.arange(4)[:, None]
        module = np.searchsorted([one.first_cell for one in scanner.detector_modules], np.arange(count), side="right")
        nodes, at = seen[cells], np.clip(wanted, seen[0], seen[-1])
        # Of values at the nodes, in the polynomial through them.
        weights = np.ones_like(nodes)
        for one, other in permutations(range(len(nodes)), 2):
            weights[one] *= (at - nodes[other]) / (nodes[one] - nodes[other])
        return cls(cells, weights, module[before] != module[before + 1])

    def resampled(self, lines: Lines) -> Lines:
        """Interpolate values (..., cells)."""
        weights = self.weights.astype(lines.dtype)
        flat: Lines = np.multiply(lines[..., self.cells[0]], weights[0])
        for cells, weight in zip(self.cells[1:], weights[1:], strict=True):
            flat += lines[..., cells] * weight
        return flat
