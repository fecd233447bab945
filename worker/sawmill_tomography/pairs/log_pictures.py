"""Pictures of a log by all fixed pairs of a scanner, on common cells along lines through the scanner's centre."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sawmill_tomography.geometry.detector_shape import cell_points
from sawmill_tomography.geometry.geometry import FanViews, FloatArray, GeometryError, SourceFrame
from sawmill_vocabulary import FixedPair

# Cells at either end of a detector show air: less than this share of the picture's largest line integral. A row shows
# a log by twice that share, and by this line integral.
END_CELLS, AIR_SHARE, LEAST_SHADOW = 5, 0.1, 0.2


@dataclass(frozen=True, eq=False)
class LogPictures:
    """Line integrals of one log by all pairs, which are the views."""

    lines: FloatArray  # (pairs, rows, cells); 0 outside of a detector
    heights_mm: FloatArray  # (rows,): equally spaced along the feed
    cells_mm: FloatArray  # (cells,): middles, on the line through the centre and across the ray from the source to it
    views: FanViews


def log_pictures(
    stacks: Sequence[FloatArray], pairs: Sequence[FixedPair], frames: Sequence[SourceFrame], row_pitch_mm: float
) -> LogPictures:
    """Resample the rows of all pairs to common heights and cells.

    Parameters
    ----------
    stacks : sequence of (rows, cells) float64
        Line integrals of each pair, air at 0, the cells clockwise about the centre.
    pairs, frames : sequence of FixedPair and SourceFrame
        The constants of each pair with its offset along the feed, and its calibrated geometry.
    row_pitch_mm : float
        Distance between two rows along the feed, mm.

    Raises
    ------
    GeometryError
        A pair shows no log or not all of it, or the pairs share fewer than three heights.
    """
    places, rows = [], np.arange(len(stacks[0])) - 0.5 * (len(stacks[0]) - 1)
    for number, (stack, pair, frame) in enumerate(zip(stacks, pairs, frames, strict=True), 1):
        deepest = stack.max(axis=1)
        if not np.median(deepest) > max(2.0 * AIR_SHARE * deepest.max(), LEAST_SHADOW):
            raise GeometryError(f"pair {number} shows a log in less than half of the rows: record the log alone")
        if max(np.median(stack[:, :END_CELLS]), np.median(stack[:, -END_CELLS:])) > AIR_SHARE * deepest.max():
            raise GeometryError(f"the log leaves the detector of pair {number}: the cells at its end show no air")
        across, along = cell_points(pair.scanner, frame).T
        places.append(frame.source_distance_mm * across / along)
    step = min(float(np.median(np.diff(place))) for place in places)
    borders = np.arange(min(place[0] for place in places), max(place[-1] for place in places), step)
    cells = borders[:-1] + 0.5 * step
    first = max(pair.feed_offset_mm for pair in pairs) + rows[0] * row_pitch_mm
    shared = min(pair.feed_offset_mm for pair in pairs) + rows[-1] * row_pitch_mm - first
    if shared < 2.0 * row_pitch_mm:
        raise GeometryError(f"the pairs' rows share {max(shared, 0.0):.3g} mm along the feed: record more rows")
    heights = first + row_pitch_mm * np.arange(int(shared / row_pitch_mm + 1e-6) + 1)
    lines = np.empty((len(places), heights.size, cells.size))
    for number, (stack, place, pair) in enumerate(zip(stacks, places, pairs, strict=True)):
        own = rows * row_pitch_mm + pair.feed_offset_mm
        resampled = np.array([np.interp(cells, place, row, left=0.0, right=0.0) for row in stack])
        lines[number] = np.array([np.interp(heights, own, column) for column in resampled.T]).T
    psi, distance = np.array([(frame.psi_rad, frame.source_distance_mm) for frame in frames]).T
    axis = np.stack([np.cos(psi), np.sin(psi)], -1)
    source = distance[:, None] * np.stack([axis[:, 1], -axis[:, 0]], -1)
    views = FanViews.of(source, 0.0 * source, axis, np.stack([borders[:-1], borders[1:]], -1))
    return LogPictures(lines, heights, cells, views)
