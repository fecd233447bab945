"""Images and sinograms as PNG, with NumPy and Pillow only, and as arrays for programs that apply a window themselves.

A PNG's row is +x and its column is +y (docs/look-up/conventions.md#axes).
"""

from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from PIL.PngImagePlugin import PngInfo

from sawmill_calibration.pictures import pages
from sawmill_calibration.pictures.pages import Window, by_stripes, labelled_views, painted, shaded, to_unit, window_of
from sawmill_calibration.pictures.round_numbers import round_length
from sawmill_vocabulary import ColorMap

SMALLEST_SIDE_PX = 512
# A JPEG of 512 x 512 pixels with noise takes 50 kB; a PNG takes 170 kB and 20 times as long to encode.
JPEG_QUALITY = 75


def image_png(
    image: NDArray[np.floating[Any]],
    *,
    pixel_mm: float | None,
    unit: str,
    window: Window | None = None,
    color_map: ColorMap = ColorMap.GREY,
    title: str | None = None,
) -> bytes:
    """Draw an image for people: 8 bits, enlarged to 512 pixels or more, with a scale bar and a colour bar.

    Parameters
    ----------
    image : (x, y) float
        Row +x, column +y.
    pixel_mm : float or None
        Side of a pixel; None leaves the scale bar out.
    unit : str
        Unit of the values, for the colour bar.
    window : (low, high), optional
        Values shown at the ends of the colour map; the 0.1 and 99.9 percentiles by default.
    color_map : ColorMap
        Grey, from black to white, by default.
    title : str, optional
        One line above.

    Returns
    -------
    bytes
        A PNG file.

    Raises
    ------
    ValueError
        The image is not two-dimensional or not finite.
    """
    _check_two_dimensional("image", image)
    shown = window or window_of(image)
    factor = max(1, -(-SMALLEST_SIDE_PX // min(image.shape)))
    size = image.shape[1] * factor, image.shape[0] * factor
    layout = pages.Layout.around(size, axis_labels=False, title=title is not None)
    page, draw = pages.page_of(layout, title, color_map)
    pages.draw_panel(page, layout, image, shown, color_map)
    pages.draw_color_bar(draw, page, layout, shown, unit, color_map)
    if pixel_mm is not None:
        pages.draw_scale_bar(draw, layout, pixel_mm / factor)
    pages.draw_orientation(draw, layout)
    return pages.encoded(page)


def bare_png(image: NDArray[np.floating[Any]], *, field_mm: float, window: Window) -> bytes:
    """Draw an image without a frame, 8-bit grey, 512 pixels or more, with a scale bar inside, to overlay on another.

    Parameters
    ----------
    image : (x, y) float
        Row +x, column +y.
    field_mm : float
        Side of the image.
    window : (low, high)
        Values shown black and white.
    """
    _check_two_dimensional("image", image)
    factor = max(1, -(-SMALLEST_SIDE_PX // min(image.shape)))
    size = image.shape[1] * factor, image.shape[0] * factor
    panel = Image.fromarray(shaded(image, window)).resize(size, Image.Resampling.NEAREST)
    draw, side = ImageDraw.Draw(panel), panel.width
    length_mm = round_length(field_mm / 4)
    left, bottom, thickness = side // 25, panel.height - side // 25, max(4, side // 100)
    right = left + round(length_mm / field_mm * side)
    draw.rectangle((left, bottom - thickness, right, bottom), fill="white", outline="black")
    place, font = ((left + right) / 2, bottom - 2 * thickness), pages.font_of(side // 22)
    draw.text(place, f"{length_mm:g} mm", fill="white", stroke_fill="black", stroke_width=2, font=font, anchor="mb")
    return pages.encoded(panel)


def jpeg(image: NDArray[np.floating[Any]], window: Window, color_map: ColorMap = ColorMap.GREY) -> bytes:
    """Encode an image in few bytes for a preview: 8 bits per colour, one pixel per pixel, no frame, not exact.

    Parameters
    ----------
    image : (x, y) float
        Row +x, column +y.
    window : (low, high)
        Values shown at the ends of the colour map.
    color_map : ColorMap
        Grey, from black to white, by default.
    """
    _check_two_dimensional("image", image)
    stream = BytesIO()
    Image.fromarray(shaded(image, window, color_map)).save(stream, format="JPEG", quality=JPEG_QUALITY)
    return stream.getvalue()


def image_png16(
    image: NDArray[np.floating[Any]],
    window: Window | None = None,
    *,
    pixel_mm: float,
    first_pixel_mm: tuple[float, float],
) -> bytes:
    """Encode an image for machines: 16-bit grey, one pixel per pixel, no frame.

    The PNG's text chunks hold the window and the position: `window_low` and `window_high` are the values of grey 0 and
    65535; `first_pixel_mm` is x and y of the centre of pixel [0, 0], separated by a comma, next to `pixel_mm`.

    Parameters
    ----------
    image : (x, y) float
        Row +x, column +y.
    window : (low, high), optional
        The whole range of the values by default.
    pixel_mm : float
        Distance between pixels.
    first_pixel_mm : (x, y)
        Centre of pixel [0, 0].
    """
    _check_two_dimensional("image", image)
    shown = window or window_of(image, 0.0, 100.0)
    grey = by_stripes(image, lambda stripe: np.rint(to_unit(stripe, shown) * 65535).astype(np.uint16))
    text = PngInfo()
    for name, value in zip(("window_low", "window_high"), shown, strict=True):
        text.add_text(name, repr(float(value)))
    text.add_text("pixel_mm", repr(float(pixel_mm)))
    text.add_text("first_pixel_mm", ",".join(repr(float(place)) for place in first_pixel_mm))
    return pages.encoded(Image.fromarray(grey), text)


def sinogram_png(
    sinogram: NDArray[np.floating[Any]], *, angles_deg: NDArray[np.floating[Any]], pitch_mm: float, unit: str
) -> bytes:
    """Draw a sinogram for people: 8-bit grey, views downwards with their angles, the detector to the right in mm.

    Parameters
    ----------
    sinogram : (views, detector) float
    angles_deg : (views,) float
        Each view's angle, for the labels.
    pitch_mm : float
        Distance between cells; the middle of the detector is 0.
    unit : str
        Unit of the values, for the colour bar.
    """
    _check_two_dimensional("sinogram", sinogram)
    views, cells = sinogram.shape
    if len(angles_deg) != views:
        raise ValueError(f"a sinogram of {views} views needs as many angles, not {len(angles_deg)}")
    shown = window_of(sinogram)
    layout = pages.Layout.around((_enlarged(cells), _enlarged(views)), axis_labels=True, title=True)
    page, draw = pages.page_of(layout, None)
    pages.draw_panel(page, layout, sinogram, shown, ColorMap.GREY)
    pages.draw_color_bar(draw, page, layout, shown, unit)
    half = cells * pitch_mm / 2
    pages.draw_bottom_axis(draw, layout, (-half, half), "position on the detector, mm")
    marks = [((view + 0.5) / views, label) for view, label in labelled_views(angles_deg)]
    pages.draw_left_axis(draw, layout, marks, "angle of the view, degrees")
    return pages.encoded(page)


def _check_two_dimensional(name: str, values: NDArray[Any]) -> None:
    if values.ndim != 2 or 0 in values.shape:
        raise ValueError(f"a picture needs a two-dimensional {name}, not one of shape {values.shape}")


def _enlarged(length: int) -> int:
    return length * max(1, -(-SMALLEST_SIDE_PX // length))


THUMBNAIL_PX = 160
Float32 = NDArray[np.float32]


def averaged(image: NDArray[np.floating[Any]], factor: int) -> Float32:
    """Average blocks of factor x factor pixels; an incomplete last block is averaged over the pixels that it has.

    Parameters
    ----------
    image : (x, y) float
    factor : int
        Side of a block, 1 or more; 1 leaves the image unchanged.

    Returns
    -------
    (ceil(x / factor), ceil(y / factor)) float32
    """
    single = image.astype(np.float32, copy=False)
    return single if factor == 1 else np.asarray(Image.fromarray(single).reduce(factor))


def npy(values: NDArray[Any]) -> bytes:
    """Return the bytes of an NPY file, version 1.0 (numpy.org, NEP 1), in C order."""
    stream = BytesIO()
    np.lib.format.write_array(stream, np.ascontiguousarray(values), version=(1, 0), allow_pickle=False)
    return stream.getvalue()


def thumbnail_png(image: NDArray[np.floating[Any]], window: Window | None = None) -> bytes:
    """Draw a small square grey picture with nothing around the image, for an image of any shape.

    Parameters
    ----------
    image : (row, column) float
    window : (low, high), optional
        Values shown black and white; the 0.1 and 99.9 percentiles by default.
    """
    return pages.encoded(Image.fromarray(painted(small_square(image, THUMBNAIL_PX, window), ColorMap.GREY)))


def small_square(image: NDArray[np.floating[Any]], side_px: int, window: Window | None = None) -> Float32:
    """Reduce an image of any shape to a square, from 0 for black to 1 for white; the window as in `thumbnail_png`."""
    shown = window or window_of(image)
    small = Image.fromarray(by_stripes(image, lambda stripe: to_unit(stripe, shown).astype(np.float32)))
    return np.asarray(small.resize((side_px, side_px), Image.Resampling.BOX))


def grey_png(grey: bytes, side_px: int) -> bytes:
    """Encode a square picture of one byte for each pixel, from 0 for black to 255 for white."""
    return pages.encoded(Image.frombytes("L", (side_px, side_px), grey))
