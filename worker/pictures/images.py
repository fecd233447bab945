"""Images and sinograms as PNG, with NumPy and Pillow alone.

A PNG's row is +x and its column is +y (DESIGN section 3).
"""

from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from PIL.PngImagePlugin import PngInfo

from worker.pictures.windows import Window, round_length, ticks, to_unit, window_of

SMALLEST_SIDE_PX = 512
INK = 20
PAPER = 255
FRAME = 120

Drawing = ImageDraw.ImageDraw


@dataclass(frozen=True)
class _Layout:
    """Where things stand around the panel, in pixels; all of it grows with the panel."""

    panel: tuple[int, int]
    width: int
    height: int
    left: int
    top: int
    font_px: int

    @classmethod
    def around(cls, panel: Image.Image, *, axis_labels: bool, title: bool) -> "_Layout":
        font_px = max(15, round(min(panel.size) / 34))
        left = round(5.2 * font_px) if axis_labels else font_px
        top = round(2.4 * font_px) if title else font_px
        return cls(
            panel=panel.size,
            width=left + panel.width + round(8.5 * font_px),
            height=top + panel.height + round(3.4 * font_px),
            left=left,
            top=top,
            font_px=font_px,
        )

    @property
    def font(self) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
        return ImageFont.load_default(size=self.font_px)


def image_png(
    image: NDArray[np.floating[Any]],
    *,
    pixel_mm: float | None,
    unit: str,
    window: Window | None = None,
    title: str | None = None,
) -> bytes:
    """An image for people: 8-bit grey, enlarged to 512 pixels or more, with a scale bar and a colour bar.

    Parameters
    ----------
    image : (x, y) float
        Row +x, column +y.
    pixel_mm : float or None
        Side of a pixel; None leaves the scale bar out.
    unit : str
        Of the values, for the colour bar.
    window : (low, high), optional
        Values shown black and white; the 0.1 and 99.9 percentiles by default.
    title : str, optional
        One line above.

    Returns
    -------
    bytes
        A PNG file.

    Raises
    ------
    ValueError
        When the image is not two-dimensional or not finite.
    """
    _check_two_dimensional("image", image)
    shown = window or window_of(image)
    factor = max(1, -(-SMALLEST_SIDE_PX // min(image.shape)))
    panel = _grey(image, shown, (image.shape[1] * factor, image.shape[0] * factor))
    layout = _Layout.around(panel, axis_labels=False, title=title is not None)
    page, draw = _page(panel, layout, title)
    _draw_color_bar(draw, page, layout, shown, unit)
    if pixel_mm is not None:
        _draw_scale_bar(draw, layout, pixel_mm / factor)
    below = layout.top + panel.height + round(1.7 * layout.font_px)
    right = layout.left + panel.width
    draw.text((right, below), "down +x, right +y", fill=FRAME, font=layout.font, anchor="rm")
    return _encoded(page)


def image_png16(image: NDArray[np.floating[Any]], window: Window | None = None) -> bytes:
    """An image for machines: 16-bit grey, one pixel a pixel, nothing drawn.

    The window stands in the PNG's text chunks: `window_low` and `window_high` are the values of grey 0 and 65535.

    Parameters
    ----------
    image : (x, y) float
        Row +x, column +y.
    window : (low, high), optional
        The whole range of the values by default.
    """
    _check_two_dimensional("image", image)
    shown = window or window_of(image, 0.0, 100.0)
    grey = np.rint(to_unit(image, shown) * 65535).astype(np.uint16)
    text = PngInfo()
    for name, value in zip(("window_low", "window_high"), shown, strict=True):
        text.add_text(name, repr(float(value)))
    return _encoded(Image.fromarray(grey), text)


def sinogram_png(
    sinogram: NDArray[np.floating[Any]],
    *,
    angles_deg: NDArray[np.floating[Any]],
    pitch_mm: float,
    unit: str,
) -> bytes:
    """A sinogram for people: 8-bit grey, views downwards with their angles, the detector to the right in mm.

    Parameters
    ----------
    sinogram : (views, detector) float
    angles_deg : (views,) float
        Each view's angle, for the labels.
    pitch_mm : float
        Distance between cells; the middle of the detector is 0.
    unit : str
        Of the values, for the colour bar.
    """
    _check_two_dimensional("sinogram", sinogram)
    views, cells = sinogram.shape
    if len(angles_deg) != views:
        raise ValueError(f"a sinogram of {views} views needs as many angles, not {len(angles_deg)}")
    shown = window_of(sinogram)
    width, height = _enlarged(cells), _enlarged(views)
    panel = _grey(sinogram, shown, (width, height))
    layout = _Layout.around(panel, axis_labels=True, title=True)
    page, draw = _page(panel, layout, None)
    _draw_color_bar(draw, page, layout, shown, unit)
    _draw_detector_axis(draw, layout, cells * pitch_mm)
    _draw_view_axis(draw, layout, angles_deg)
    return _encoded(page)


def _check_two_dimensional(name: str, values: NDArray[Any]) -> None:
    if values.ndim != 2 or 0 in values.shape:
        raise ValueError(f"a picture needs a two-dimensional {name}, not one of shape {values.shape}")


def _enlarged(length: int) -> int:
    return length * max(1, -(-SMALLEST_SIDE_PX // length))


def _grey(values: NDArray[np.floating[Any]], window: Window, size: tuple[int, int]) -> Image.Image:
    grey = np.rint(to_unit(values, window) * 255).astype(np.uint8)
    # Nearest: what a pixel shows is what was computed.
    return Image.fromarray(grey).resize(size, Image.Resampling.NEAREST)


def _page(panel: Image.Image, layout: _Layout, title: str | None) -> tuple[Image.Image, Drawing]:
    page = Image.new("L", (layout.width, layout.height), PAPER)
    page.paste(panel, (layout.left, layout.top))
    draw = ImageDraw.Draw(page)
    _draw_frame(draw, layout.left, layout.top, panel.size)
    if title is not None:
        draw.text((layout.left, layout.top / 2), title, fill=INK, font=layout.font, anchor="lm")
    return page, draw


def _draw_frame(draw: Drawing, left: int, top: int, size: tuple[int, int]) -> None:
    draw.rectangle((left - 1, top - 1, left + size[0], top + size[1]), outline=FRAME)


def _draw_color_bar(draw: Drawing, page: Image.Image, layout: _Layout, window: Window, unit: str) -> None:
    width, left = layout.font_px, layout.left + layout.panel[0] + layout.font_px
    ramp = np.linspace(255, 0, layout.panel[1]).astype(np.uint8)[:, np.newaxis].repeat(width, axis=1)
    page.paste(Image.fromarray(ramp), (left, layout.top))
    _draw_frame(draw, left, layout.top, (width, layout.panel[1]))
    text_left = left + width + layout.font_px // 2
    for value, y, anchor in ((window[1], layout.top, "lt"), (window[0], layout.top + layout.panel[1], "lb")):
        draw.text((text_left, y), f"{value:.3g}", fill=INK, font=layout.font, anchor=anchor)
    shown_unit = "" if unit == "1" else unit
    draw.text((text_left, layout.top + layout.panel[1] / 2), shown_unit, fill=INK, font=layout.font, anchor="lm")


def _draw_scale_bar(draw: Drawing, layout: _Layout, mm_per_px: float) -> None:
    length_mm = round_length(layout.panel[0] * mm_per_px / 3)
    length, thickness = round(length_mm / mm_per_px), max(4, layout.font_px // 3)
    middle = layout.top + layout.panel[1] + round(1.7 * layout.font_px)
    draw.rectangle((layout.left, middle - thickness // 2, layout.left + length - 1, middle + thickness // 2), fill=INK)
    x = layout.left + length + layout.font_px // 2
    draw.text((x, middle), f"{length_mm:g} mm", fill=INK, font=layout.font, anchor="lm")


def _draw_detector_axis(draw: Drawing, layout: _Layout, length_mm: float) -> None:
    bottom = layout.top + layout.panel[1]
    for value in ticks(-length_mm / 2, length_mm / 2):
        x = layout.left + (value / length_mm + 0.5) * layout.panel[0]
        draw.line((x, bottom, x, bottom + layout.font_px // 3), fill=INK)
        draw.text((x, bottom + layout.font_px // 2), f"{value:g}", fill=INK, font=layout.font, anchor="mt")
    middle = layout.left + layout.panel[0] / 2
    y = layout.height - layout.font_px // 2
    draw.text((middle, y), "position on the detector, mm", fill=INK, font=layout.font, anchor="mb")


def _draw_view_axis(draw: Drawing, layout: _Layout, angles_deg: NDArray[np.floating[Any]]) -> None:
    views = len(angles_deg)
    for view in np.unique(np.linspace(0, views - 1, min(views, 7)).round().astype(int)):
        y = layout.top + (view + 0.5) / views * layout.panel[1]
        draw.line((layout.left - layout.font_px // 3, y, layout.left, y), fill=INK)
        label = f"{angles_deg[view]:.4g}"
        draw.text((layout.left - layout.font_px // 2, y), label, fill=INK, font=layout.font, anchor="rm")
    draw.text(
        (layout.font_px // 2, layout.top / 2), "angle of the view, degrees", fill=INK, font=layout.font, anchor="lm"
    )


def _encoded(image: Image.Image, text: PngInfo | None = None) -> bytes:
    stream = BytesIO()
    image.save(stream, format="PNG", pnginfo=text)
    return stream.getvalue()
