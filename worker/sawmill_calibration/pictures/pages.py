"""Page around a panel of pixels: frame, colour bar, scale bar, axes in mm; grey windows; the encoded PNG.

Pages are drawn with Pillow instead of matplotlib: a slice of 256 x 256 takes a twelfth of the time, a pixel of the
slice covers an equal number of pixels of the picture, and the service starts half a second faster.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from PIL.PngImagePlugin import PngInfo

from sawmill_calibration.pictures.round_numbers import round_length, ticks
from sawmill_vocabulary import ColorMap

Window = tuple[float, float]
MOST_LABELS = 7
# Percentiles of a log's grey window, chosen so that the ring of a dead cell does not darken the wood.
LOG_WINDOW = (0.5, 99.5)
NOT_FINITE = "a picture cannot show values that are not finite"
# Values that are converted at a time: what is computed on the way takes some 10 MB.
_STRIPE_VALUES = 2**18


def window_of(values: NDArray[np.floating[Any]], low: float = 0.1, high: float = 99.9) -> Window:
    """Return a window between two percentiles; of width 1 if all values are equal.

    Raises
    ------
    ValueError
        A value is not finite.
    """
    lowest, highest = (float(v) for v in np.percentile(values, (low, high)))
    if not (math.isfinite(lowest) and math.isfinite(highest)):
        raise ValueError(NOT_FINITE)
    return (lowest, highest) if highest > lowest else (lowest - 0.5, lowest + 0.5)


def to_unit(values: NDArray[np.floating[Any]], window: Window) -> NDArray[np.float64]:
    """Convert values to fractions of the window, clipped to 0..1."""
    low, high = window
    if not low < high:
        raise ValueError(f"a window must be (low, high) with low < high, not {window}")
    if not np.isfinite(values).all():
        raise ValueError(NOT_FINITE)
    return np.clip((np.asarray(values, dtype=np.float64) - low) / (high - low), 0.0, 1.0)


def stripes(values: NDArray[Any]) -> Iterator[slice]:
    """Yield stripes of an image's rows, to be converted one at a time: what is computed on the way takes memory."""
    step = max(1, _STRIPE_VALUES // values.shape[1])
    return (slice(first, first + step) for first in range(0, len(values), step))


def by_stripes(values: NDArray[Any], convert: Callable[[NDArray[Any]], NDArray[Any]]) -> NDArray[Any]:
    """Convert an image stripe by stripe."""
    return np.concatenate([convert(values[stripe]) for stripe in stripes(values)])


def labelled_views(angles_deg: NDArray[np.floating[Any]]) -> list[tuple[int, str]]:
    """Select views spread over a sinogram, each labelled with its own angle: views need not be equidistant."""
    views = len(angles_deg)
    shown = np.unique(np.linspace(0, views - 1, min(views, MOST_LABELS)).round().astype(int))
    return [(int(view), f"{angles_deg[view]:.4g}") for view in shown]


def shaded(values: NDArray[np.floating[Any]], window: Window, color_map: ColorMap = ColorMap.GREY) -> NDArray[np.uint8]:
    """Convert values of a two-dimensional image to 8-bit grey or colours, as `painted` does fractions."""
    return by_stripes(values, lambda stripe: painted(to_unit(stripe, window), color_map))


def painted(fractions: NDArray[np.floating[Any]], color_map: ColorMap) -> NDArray[np.uint8]:
    """Convert fractions 0..1 of a window to 8-bit grey of the same shape, or to colours (..., 3)."""
    steps: NDArray[np.uint8] = np.rint(fractions * 255).astype(np.uint8)
    return steps if color_map is ColorMap.GREY else np.take(color_table(color_map), steps, axis=0)


@cache
def color_table(color_map: ColorMap) -> NDArray[np.uint8]:
    """Return the map's 256 colours, (256, 3), from the window's low end to its high end."""
    if color_map is ColorMap.GREY:
        return np.arange(256, dtype=np.uint8)[:, np.newaxis].repeat(3, axis=1)
    # Imported here because a grey picture needs no matplotlib, whose colour maps alone take half a second to import.
    from matplotlib import colormaps  # noqa: PLC0415

    return colormaps[color_map](np.arange(256), bytes=True)[:, :3]


INK = "#141414"
PAPER = "#ffffff"
FRAME = "#787878"

Drawing = ImageDraw.ImageDraw
Span = tuple[float, float]


@dataclass(frozen=True)
class Layout:
    """Positions around the panel, in pixels, which scale with the panel."""

    panel: tuple[int, int]
    width: int
    height: int
    left: int
    top: int
    font_px: int

    @classmethod
    def around(cls, panel: tuple[int, int], *, axis_labels: bool, title: bool) -> "Layout":
        """Reserve room for a colour bar on the right, a line below, and the requested labels and title."""
        font_px = max(15, round(min(panel) / 34))
        left = round(5.2 * font_px) if axis_labels else font_px
        top = round(2.4 * font_px) if title else font_px
        return cls(
            panel=panel,
            # Wide enough for the longest unit, the unit of line integrals.
            width=left + panel[0] + round(10.4 * font_px),
            height=top + panel[1] + round(3.4 * font_px),
            left=left,
            top=top,
            font_px=font_px,
        )

    @property
    def font(self) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
        """Font of the text around the panel."""
        return font_of(self.font_px)


def font_of(size_px: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Return Pillow's own font, so that pictures do not depend on the fonts of a machine."""
    return ImageFont.load_default(size=size_px)


def draw_panel(
    page: Image.Image, layout: Layout, values: NDArray[np.floating[Any]], window: Window, color_map: ColorMap
) -> None:
    """Draw values as pixels, enlarged to the panel, whose height is a multiple of the number of rows."""
    width, height = layout.panel
    factor = height // len(values)
    for stripe in stripes(values):
        part = Image.fromarray(shaded(values[stripe], window, color_map))
        # Nearest neighbour: a pixel shows a computed value.
        enlarged = part.resize((width, part.height * factor), Image.Resampling.NEAREST)
        page.paste(enlarged, (layout.left, layout.top + stripe.start * factor))


def page_of(
    layout: Layout, title: str | None, color_map: ColorMap = ColorMap.GREY, *, framed: bool = True
) -> tuple[Image.Image, Drawing]:
    """Create a page for the panel, with the title above the panel if there is one."""
    page = Image.new("L" if color_map is ColorMap.GREY else "RGB", (layout.width, layout.height), PAPER)
    draw = ImageDraw.Draw(page)
    if framed:
        _draw_frame(draw, layout.left, layout.top, layout.panel)
    if title is not None:
        draw.text((layout.left, layout.top / 2), title, fill=INK, font=layout.font, anchor="lm")
    return page, draw


def draw_color_bar(
    draw: Drawing, page: Image.Image, layout: Layout, window: Window, unit: str, color_map: ColorMap = ColorMap.GREY
) -> None:
    """Draw the window's values and their unit, right of the panel."""
    width, left = layout.font_px, layout.left + layout.panel[0] + layout.font_px
    ramp = np.linspace(1.0, 0.0, layout.panel[1])[:, np.newaxis].repeat(width, axis=1)
    page.paste(Image.fromarray(painted(ramp, color_map)), (left, layout.top))
    _draw_frame(draw, left, layout.top, (width, layout.panel[1]))
    text_left = left + width + layout.font_px // 2
    for value, y, anchor in ((window[1], layout.top, "lt"), (window[0], layout.top + layout.panel[1], "lb")):
        draw.text((text_left, y), f"{value:.3g}", fill=INK, font=layout.font, anchor=anchor)
    shown_unit = "" if unit == "1" else unit
    draw.text((text_left, layout.top + layout.panel[1] / 2), shown_unit, fill=INK, font=layout.font, anchor="lm")


def draw_scale_bar(draw: Drawing, layout: Layout, mm_per_px: float, across_px: int | None = None) -> None:
    """Draw a round length below the panel, at most a quarter of the panel or of `across_px` pixels."""
    length_mm = round_length((across_px or layout.panel[0]) * mm_per_px / 4)
    length, thickness = round(length_mm / mm_per_px), max(4, layout.font_px // 3)
    middle = layout.top + layout.panel[1] + round(1.7 * layout.font_px)
    draw.rectangle((layout.left, middle - thickness // 2, layout.left + length - 1, middle + thickness // 2), fill=INK)
    x = layout.left + length + layout.font_px // 2
    draw.text((x, middle), f"{length_mm:g} mm", fill=INK, font=layout.font, anchor="lm")


def draw_orientation(draw: Drawing, layout: Layout) -> None:
    """Draw the directions of x and y in a slice, below the panel."""
    below = layout.top + layout.panel[1] + round(1.7 * layout.font_px)
    draw.text((layout.left + layout.panel[0], below), "down +x, right +y", fill=FRAME, font=layout.font, anchor="rm")


def draw_bottom_axis(draw: Drawing, layout: Layout, span: Span, label: str) -> None:
    """Draw round values of `span` below the panel, from left to right."""
    bottom = layout.top + layout.panel[1]
    for value in ticks(*span):
        x = layout.left + (value - span[0]) / (span[1] - span[0]) * layout.panel[0]
        draw.line((x, bottom, x, bottom + layout.font_px // 3), fill=INK)
        draw.text((x, bottom + layout.font_px // 2), f"{value:g}", fill=INK, font=layout.font, anchor="mt")
    middle = layout.left + layout.panel[0] / 2
    draw.text((middle, (layout.height - layout.font_px // 2)), label, fill=INK, font=layout.font, anchor="mb")


def draw_left_axis(draw: Drawing, layout: Layout, marks: Sequence[tuple[float, str]], label: str) -> None:
    """Draw labelled marks left of the panel, at fractions of the panel's height from the top."""
    for fraction, text in marks:
        y = layout.top + fraction * layout.panel[1]
        draw.line((layout.left - layout.font_px // 3, y, layout.left, y), fill=INK)
        draw.text((layout.left - layout.font_px // 2, y), text, fill=INK, font=layout.font, anchor="rm")
    draw.text((layout.font_px // 2, layout.top / 2), label, fill=INK, font=layout.font, anchor="lm")


def encoded(image: Image.Image, text: PngInfo | None = None) -> bytes:
    """Encode the image as the bytes of a PNG file."""
    stream = BytesIO()
    image.save(stream, format="PNG", pnginfo=text)
    return stream.getvalue()


def _draw_frame(draw: Drawing, left: int, top: int, size: tuple[int, int]) -> None:
    draw.rectangle((left - 1, top - 1, left + size[0], top + size[1]), outline=FRAME)
