"""Style of the page's pictures: colour-blind-safe colours (Okabe and Ito), units on every axis, small files."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image as Picture

from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.projection.projector import Image

BLUE, ORANGE, GREEN, PURPLE, SKY, BLACK = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#222222"
DPI = 100
COLOURS_KEPT = 128
GREYS_KEPT = 20


def figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure whose parts do not overlap."""
    return Figure(figsize=(width_in, height_in), dpi=DPI, layout="constrained")


def save(drawn: Figure, path: Path) -> None:
    """Write a PNG with a palette: a third of the size, and no difference to be seen."""
    path.parent.mkdir(parents=True, exist_ok=True)
    drawn.savefig(path)
    with Picture.open(path) as full:
        few = full.convert("RGB").quantize(COLOURS_KEPT, dither=Picture.Dither.NONE)
    few.save(path, optimize=True)


def save_greys(drawn: Figure, path: Path) -> None:
    """Write a PNG of a few evenly spaced greys: a palette fitted to the picture would leave rare shades speckled."""
    path.parent.mkdir(parents=True, exist_ok=True)
    drawn.savefig(path)
    step = 255.0 / (GREYS_KEPT - 1)
    with Picture.open(path) as full:
        levels = np.round(np.asarray(full.convert("L")) / step).astype(np.uint8)
    few = Picture.fromarray(levels)
    few.putpalette(np.round(np.arange(GREYS_KEPT) * step).astype(np.uint8).repeat(3).tolist())
    few.save(path, optimize=True)


def show_image(axes: Axes, image: Image, field_mm: float, limits: tuple[float, float], title: str) -> None:
    """Draw an image [x, y] as the product's PNGs have it: +x downwards, +y to the right."""
    half = 0.5 * field_mm
    axes.imshow(image, cmap="gray", vmin=limits[0], vmax=limits[1], extent=(-half, half, half, -half))
    axes.set_title(title, fontsize=9)
    axes.set_xlabel("y, mm", fontsize=8)
    axes.set_ylabel("x, mm", fontsize=8)
    axes.tick_params(labelsize=7)


def ellipse(mean: FloatArray, covariance: FloatArray, *, squared_radius: float = 5.991) -> FloatArray:
    """Return the outline (points, 2) of the 95 % region of a Gaussian with this mean (2,) and covariance (2, 2)."""
    values, vectors = np.linalg.eigh(covariance)
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    circle = np.stack([np.cos(turn), np.sin(turn)])
    outline: FloatArray = mean + (vectors @ (np.sqrt(squared_radius * np.maximum(values, 0.0))[:, None] * circle)).T
    return outline


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Format a Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
