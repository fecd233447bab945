"""Panels of reconstructions: the phantom under its outlines, and a log before and after.

A picture's row is +x and its column is +y (docs/look-up/conventions.md#axes).
"""

from io import BytesIO
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from sawmill_worker.pictures.round_numbers import round_length
from sawmill_worker.pictures.windows import LOG_WINDOW, Window, window_of

OUTLINE = "#ff7f0e"


def draw_phantom(figure: FigureBase, ax: Axes, image: NDArray[Any], field_mm: float, outlines: NDArray[Any]) -> None:
    """Draw a phantom's reconstruction with the drawing's outlines over the image.

    Parameters
    ----------
    image : (x, y) float
        The reconstruction.
    field_mm : float
        Side of the image.
    outlines : (points, 2) float
        Closed outlines as (x, y) in mm, NaN between two outlines.
    """
    shown = show_image(ax, image, field_mm, window_of(image, *LOG_WINDOW))
    if len(outlines):
        ax.plot(outlines[:, 1], outlines[:, 0], color=OUTLINE, linewidth=1.4, label="the drawing's outline")
        ax.legend(loc="upper right", framealpha=0.85)
    figure.colorbar(shown, ax=ax, shrink=0.85, pad=0.02)


def draw_logs(figure: FigureBase, images: list[tuple[str, NDArray[Any]]], field_mm: float, unit: str) -> None:
    """Draw one or two reconstructions (x, y) of a log, each under its title, in the grey window of the last image."""
    window = window_of(images[-1][1], *LOG_WINDOW)
    axes = [figure.add_subplot(1, 2, 1 + index) for index in range(len(images))]
    for ax, (title, image) in zip(axes, images, strict=True):
        shown = show_image(ax, image, field_mm, window)
        _draw_scale_bar(ax, field_mm)
        ax.set_title(title, fontsize=13)
    figure.colorbar(shown, ax=axes, label=unit, shrink=0.9, pad=0.015)


def show_image(
    ax: Axes, image: NDArray[Any], field_mm: float, window: Window, centre_mm: tuple[float, float] = (0.0, 0.0)
) -> AxesImage:
    """Show an image (x, y) in mm, the rotation centre at the origin; `centre_mm` is (x, y) of the field's centre."""
    half, (x, y) = field_mm / 2, centre_mm
    extent = (y - half, y + half, x + half, x - half)
    shown = ax.imshow(image, cmap="gray", vmin=window[0], vmax=window[1], extent=extent, interpolation="nearest")
    ax.set_xlabel("y, mm")
    ax.set_ylabel("x, mm")
    return shown


def encoded(figure: Figure) -> bytes:
    """Encode the figure as a PNG file."""
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=100)
    return stream.getvalue()


def _draw_scale_bar(ax: Axes, field_mm: float) -> None:
    length, half = round_length(field_mm / 4), field_mm / 2
    left, below = -half + 0.05 * field_mm, half - 0.06 * field_mm
    ax.plot([left, left + length], [below, below], color="white", linewidth=4, solid_capstyle="butt")
    ax.text(left + length / 2, below - 0.02 * field_mm, f"{length:g} mm", color="white", ha="center", fontsize=11)
