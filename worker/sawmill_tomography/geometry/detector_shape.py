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
from numpy.typing import NDArray

from sawmill_vocabulary import DetectorModule, Scanner, SourceFrame

FloatArray = NDArray[np.float64]
Length = FloatArray | float
Lines = TypeVar("Lines", NDArray[np.float32], NDArray[np.float64])


def cell_borders_mm(scanner: Scanner) -> FloatArray:
    """Return the detector coordinate u of the cells' borders, (cells + 1,) mm."""
    n = scanner.num_detector_pixels
    return (np.arange(n + 1, dtype=np.float64) - 0.5 * n) * scanner.detector_pitch_mm


def cell_centres_mm(scanner: Scanner) -> FloatArray:
    """Return u_m = (m + 1/2 - n_D/2) pitch of each cell m, (cells,) mm."""
    n = scanner.num_detector_pixels
    return (np.arange(n, dtype=np.float64) + 0.5 - 0.5 * n) * scanner.detector_pitch_mm


class DetectorLines(NamedTuple):
    """The flat pieces of a detector, in the order of the cells: each is a flat line detector of its own."""

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
) -> DetectorLines:
    """Return the flat pieces: a module, or on an arc `piece_cells` cells, which touch it at their middle.

    The source frame describes the module that holds the detector's middle, or the line that touches the arc there. A
    gap moves a module along the module before, a kink turns it about the end of that module.
    """
    borders = [0, *(module.first_cell for module in modules), cells]
    middle = sum(border <= cells // 2 for border in borders[1:-1])
    # Of each module: the line that touches its arc at the detector's middle, by a point at which the coordinate is u.
    touching: dict[int, tuple[Length, Length, Length, Length]] = {
        middle: (frame.cor_column_mm, 0.0, 0.0, frame.tilt_rad)
    }
    for step in (1, -1):
        u, x, y, tilt = touching[middle]
        for number in range(middle + step, len(modules) + 1 if step > 0 else -1, step):
            module = modules[max(number, number - step) - 1]
            along, depth, turn = _on_arc(first_border_mm + pitch_mm * module.first_cell, arc_radius_mm)
            place = _point((u, x, y, tilt), along, depth)
            place = _point((0.0, *place, tilt - turn), step * module.gap_mm, 0.0)
            u, tilt = along, tilt + step * module.kink_rad
            x, y = _point((0.0, *place, tilt), 0.0, -depth)
            touching[number] = (u, x, y, tilt)
    pieces = []
    for number, (first, end) in enumerate(pairwise(borders)):
        u, *_, tilt = line = touching[number]
        starts = np.arange(first, end, end - first if arc_radius_mm is None else piece_cells)
        ends = np.append(starts[1:], end)
        at: FloatArray = np.full(1, u) if arc_radius_mm is None else first_border_mm + 0.5 * pitch_mm * (starts + ends)
        along, depth, turn = _on_arc(at, arc_radius_mm)
        pieces.append(_lines(starts, ends, frame, at, *_point(line, along, depth), tilt - np.asarray(turn)))
    return DetectorLines(*map(np.concatenate, zip(*pieces, strict=True)))


def _on_arc(at: Length, radius_mm: float | None) -> tuple[Length, Length, Length]:
    """Return the place at a length of arc from the touching point: along the line, towards the source, and the turn."""
    if radius_mm is None:
        return at, 0.0 * at, 0.0 * at
    turn = at / radius_mm
    return radius_mm * np.sin(turn), radius_mm * (1.0 - np.cos(turn)), turn


def _point(line: tuple[Length, Length, Length, Length], along: Length, depth: Length) -> tuple[Length, Length]:
    """Return the point at a coordinate along a line (u, x, y, tilt), and at a depth towards the source."""
    u, x, y, tilt = line
    c, s = np.cos(tilt), np.sin(tilt)
    return x + (along - u) * c + depth * s, y + (along - u) * s - depth * c


def _lines(
    first: NDArray[np.intp],
    end: NDArray[np.intp],
    frame: SourceFrame,
    u: FloatArray,
    x: Length,
    y: Length,
    tilt: FloatArray,
) -> DetectorLines:
    """Return lines through points, given from the foot of the ray through the COR, at which the coordinate is u."""
    cosine, tangent, one = np.cos(tilt), np.tan(tilt), np.ones_like(tilt)
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
        scanner.detector_modules, scanner.detector_arc_radius_mm, cells, -0.5 * cells * pitch, pitch, frame
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
    flat: FloatArray = frame.cor_column_mm + frame.source_to_detector_mm * across / (along * cosine - across * sine)
    return flat


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
