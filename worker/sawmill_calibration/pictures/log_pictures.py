"""Pictures of a whole log: a mosaic of slices along the log, and a side view."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from sawmill_calibration.pictures import pages
from sawmill_calibration.pictures.pages import Window, shaded, window_of
from sawmill_calibration.pictures.round_numbers import ticks
from sawmill_vocabulary import ColorMap
from sawmill_vocabulary.side_view import SideView

TILE_PX = 256
# Space above each tile for its label, and between two tiles, pixels.
_STRIP_PX, _GAP_PX = 26, 10
# Range of widths in which a side view is drawn true to scale; a wider view shows the densest of several pixels.
_NARROWEST_PX, _WIDEST_PX = 192, 4096
_LOWEST_PX, _HIGHEST_PX = 256, 512


def spread(count: int, available: int) -> list[int]:
    """Return the indices of the slices in the middle of `count` equal parts of a log, or all indices if fewer."""
    parts = min(count, available)
    return [(2 * n + 1) * available // (2 * parts) for n in range(parts)]


def mosaic_png(
    slices: Iterable[tuple[NDArray[np.floating[Any]], str]],
    *,
    pixel_mm: float | None,
    unit: str,
    window: Window,
    color_map: ColorMap = ColorMap.GREY,
    title: str | None = None,
) -> bytes:
    """Draw slices in rows, in reading order, all in one window.

    Slices of more than 256 pixels are averaged down to 256 along each side; smaller slices are enlarged to 256 or more.

    Parameters
    ----------
    slices : iterable of (image, label)
        Images (x, y) of one size, row +x and column +y; taken one at a time.
    pixel_mm : float or None
        Side of an image's pixel; None leaves the scale bar out.
    unit : str
        Of the values, for the colour bar.
    window : (low, high)
        Values shown at the ends of the colour map.

    Raises
    ------
    ValueError
        No slices are given, or a slice is not two-dimensional or not finite.
    """
    tiles, labels, size = [], [], 0
    for image, label in slices:
        size = len(image)
        tiles.append(shaded(_tile(image), window, color_map))
        labels.append(label)
    if not tiles:
        raise ValueError("a mosaic needs at least one slice")
    side = len(tiles[0])
    panel, corners = _laid_out([Image.fromarray(tile) for tile in tiles], side)
    layout = pages.Layout.around(panel.size, axis_labels=False, title=title is not None)
    page, draw = pages.page_of(layout, title, color_map, framed=False)
    page.paste(panel, (layout.left, layout.top))
    font = pages.font_of(_STRIP_PX - 8)
    for label, (left, top) in zip(labels, corners, strict=True):
        draw.text(
            (layout.left + left, layout.top + top + _STRIP_PX // 2), label, fill=pages.INK, font=font, anchor="lm"
        )
    pages.draw_color_bar(draw, page, layout, window, unit, color_map)
    if pixel_mm is not None:
        pages.draw_scale_bar(draw, layout, pixel_mm * size / side, across_px=side)
    pages.draw_orientation(draw, layout)
    return pages.encoded(page)


def side_view_png(
    view: SideView, *, window: Window | None = None, color_map: ColorMap = ColorMap.GREY, title: str | None = None
) -> bytes:
    """Draw the largest value behind each point of a log's side: the log runs to the right, x or y downwards.

    Slices without spacing are counted.

    Parameters
    ----------
    window : (low, high), optional
        Values shown at the ends of the colour map; the 0.1 and 99.9 percentiles by default.

    Raises
    ------
    ValueError
        The view is not two-dimensional or not finite.
    """
    densest, along_mm = view.data, view.along_mm
    if densest.ndim != 2 or 0 in densest.shape:
        raise ValueError(f"a side view is two-dimensional, not of shape {densest.shape}")
    shown = window or window_of(densest)
    size = width, height = _side_view_size(densest.shape, view.across_mm, along_mm)
    layout = pages.Layout.around(size, axis_labels=True, title=True)
    page, draw = pages.page_of(layout, None, color_map)
    pages.draw_panel(page, layout, densest_of(densest.T, (height, width)), shown, color_map)
    pages.draw_color_bar(draw, page, layout, shown, view.unit, color_map)
    span = along_mm or (-0.5, len(densest) - 0.5)
    pages.draw_bottom_axis(draw, layout, span, "slice" if along_mm is None else "along the log, mm")
    low, high = view.across_mm
    marks = [((value - low) / (high - low), f"{value:g}") for value in ticks(low, high)]
    pages.draw_left_axis(
        draw, layout, marks, f"{view.across}, mm" if title is None else f"{view.across}, mm     {title}"
    )
    return pages.encoded(page)


def _tile(image: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    if image.ndim != 2 or image.shape[0] != image.shape[1] or not image.size:
        raise ValueError(f"a mosaic needs square slices, not one of shape {image.shape}")
    if len(image) <= TILE_PX:
        factor = -(-TILE_PX // len(image))
        return image.repeat(factor, axis=0).repeat(factor, axis=1)
    whole = Image.fromarray(image.astype(np.float32, copy=False))
    return np.asarray(whole.resize((TILE_PX, TILE_PX), Image.Resampling.BOX))


def _laid_out(tiles: list[Image.Image], side: int) -> tuple[Image.Image, list[tuple[int, int]]]:
    """Place the tiles on a page with a free strip above each tile; return the page and the corners of the strips."""
    columns = math.ceil(math.sqrt(len(tiles)))
    step, line = side + _GAP_PX, side + _GAP_PX + _STRIP_PX
    corners = [(n % columns * step, n // columns * line) for n in range(len(tiles))]
    panel = Image.new(tiles[0].mode, (columns * step - _GAP_PX, corners[-1][1] + line - _GAP_PX), pages.PAPER)
    for tile, (left, top) in zip(tiles, corners, strict=True):
        panel.paste(tile, (left, top + _STRIP_PX))
    return panel, corners


def _side_view_size(shape: tuple[int, ...], across_mm: pages.Span, along_mm: pages.Span | None) -> tuple[int, int]:
    """Return (width, height) of the panel."""
    slices, pixels = shape
    lines = -(-pixels // -(-pixels // _HIGHEST_PX))
    height = lines * -(-_LOWEST_PX // lines)
    shape_ratio = slices / pixels if along_mm is None else (along_mm[1] - along_mm[0]) / (across_mm[1] - across_mm[0])
    return round(min(max(height * shape_ratio, _NARROWEST_PX), _WIDEST_PX)), height


def densest_of(values: NDArray[np.floating[Any]], most: tuple[int, int]) -> NDArray[np.floating[Any]]:
    """Reduce to at most `most` values along the axes by the maximum of blocks, so that a nail stays visible."""
    for axis, limit in enumerate(most):
        step = -(-values.shape[axis] // limit)
        values = np.maximum.reduceat(values, np.arange(0, values.shape[axis], step), axis=axis)
    return values
