"""Figures of a calibration's report: images as PNG inside SVG, lines and marks as SVG.

A picture's row is +x and its column is +y (docs/look-up/conventions.md#axes).
"""

from base64 import b64encode
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from sawmill_vocabulary.calibration_arrays import CalibrationArrays
from sawmill_worker.pictures.pages import encoded
from sawmill_worker.pictures.round_numbers import round_length, ticks
from sawmill_worker.pictures.windows import LOG_WINDOW, Window, labelled_views, to_unit, window_of

# Percentile of a residual's absolute values at which the colours end.
STRONGEST = 99.5
# Largest number of pixels of a residual's picture, (views, cells): what a printed page can show.
FINEST = (400, 480)
MOST_POINTS = 240
# Blue is less than the model, red is more, in steps that a grey printer distinguishes from white.
DIVERGING = np.array([(21, 84, 158), (146, 192, 226), (255, 255, 255), (240, 164, 128), (158, 24, 32)], np.float64)


@dataclass(frozen=True)
class FigureField:
    """A square image with its side in mm and a scale bar; `outline` is an SVG path in pixels of the image."""

    href: str
    side_px: int
    bar_mm: float
    bar_px: float
    outline: str = ""


@dataclass(frozen=True)
class FigureMark:
    """A position on an axis, 0 to 1, and its label."""

    at: float
    text: str


@dataclass(frozen=True)
class Profile:
    """Lines over a common axis; a line is SVG points in a box of 1000 x 1000, larger values up."""

    rms: str
    mean: str
    zero: float
    top: str


@dataclass(frozen=True)
class ResidualFigure:
    """Measured minus model: the picture (views downwards), the end of its colours, and both profiles."""

    href: str
    size_px: tuple[int, int]
    limit: str
    views: list[FigureMark]
    cells: list[FigureMark]
    by_cell: Profile
    by_view: Profile


@dataclass(frozen=True)
class SearchFigure:
    """The best value over the evaluations, as SVG points in a box of 1000 x 1000."""

    points: str
    evaluations: list[FigureMark]
    values: list[FigureMark]


def phantom_field(arrays: CalibrationArrays) -> FigureField | None:
    """Return the phantom under the drawing's outline; None if there is no image."""
    image = arrays.phantom_image
    if not image.any():
        return None
    window = window_of(image, *LOG_WINDOW)
    outline = _path(arrays.phantom_outlines_mm, arrays.phantom_field_mm, len(image))
    return _field(image, arrays.phantom_field_mm, window, outline)


def log_fields(arrays: CalibrationArrays) -> tuple[FigureField | None, FigureField | None]:
    """Return the log before and after, in the grey window of the second image; None for a missing image."""
    log = arrays.log
    if log is None:
        return None, None
    window = window_of(log.after, *LOG_WINDOW)
    before = None if log.before is None else _field(log.before, log.field_mm, window)
    return before, _field(log.after, log.field_mm, window)


def residual_figure(arrays: CalibrationArrays, pitch_mm: float) -> ResidualFigure:
    """Draw measured minus model.

    Raises
    ------
    ValueError
        The numbers of views and angles differ.
    """
    residual, angles_deg = arrays.residual, np.rad2deg(arrays.angles_rad)
    views, cells = residual.shape
    if len(angles_deg) != views:
        raise ValueError(f"the residual {residual.shape} and {len(angles_deg)} angles do not agree")
    shown = _no_finer(residual)
    limit = float(np.percentile(np.abs(shown), STRONGEST)) or 1.0
    half_mm = cells * pitch_mm / 2
    return ResidualFigure(
        href=data_url(_diverging(shown / limit)),
        size_px=(shown.shape[1], shown.shape[0]),
        limit=f"{limit:.2g}",
        views=[FigureMark((view + 0.5) / views, f"{text}°") for view, text in labelled_views(angles_deg)],
        cells=[FigureMark(0.5 + mm / (2 * half_mm), f"{mm:g}") for mm in ticks(-half_mm, half_mm)],
        by_cell=_profile(residual, axis=0),
        by_view=_profile(residual, axis=1),
    )


def search_figure(history: NDArray[np.float64]) -> SearchFigure | None:
    """Draw the convergence of the best value, above 0 by its logarithm; return None without a history."""
    if len(history) < 2:
        return None
    evaluations, best = history[:, 0], history[:, 1]
    shown = np.log10(best) if (best > 0.0).all() else best
    low, high = float(shown.min()), float(shown.max())
    across = (evaluations - evaluations[0]) / (float(np.ptp(evaluations)) or 1.0)
    up = (shown - low) / ((high - low) or 1.0)
    corners = [(across[0], up[0])]
    for (_, level), (x, y) in pairwise(zip(across, up, strict=True)):
        corners += [(x, level), (x, y)]
    return SearchFigure(
        points=_points(corners),
        evaluations=[FigureMark(0.0, f"{evaluations[0]:.0f}"), FigureMark(1.0, f"{evaluations[-1]:.0f}")],
        values=[FigureMark(1.0, f"{best[np.argmax(shown)]:.2g}"), FigureMark(0.0, f"{best[np.argmin(shown)]:.2g}")],
    )


def data_url(image: Image.Image) -> str:
    """Encode a picture as a URL inside the page."""
    return "data:image/png;base64," + b64encode(encoded(image)).decode("ascii")


def _field(image: NDArray[Any], field_mm: float, window: Window, outline: str = "") -> FigureField:
    grey = np.rint(to_unit(image, window) * 255).astype(np.uint8)
    bar_mm = round_length(field_mm / 4)
    return FigureField(data_url(Image.fromarray(grey)), len(image), bar_mm, bar_mm / field_mm * len(image), outline)


def _path(outlines_mm: NDArray[np.float64], field_mm: float, side_px: int) -> str:
    """Convert closed outlines (x, y), separated by a row of NaN, to an SVG path: right is +y, down is +x."""
    pieces = []
    for piece in _pieces(outlines_mm):
        px = (piece / field_mm + 0.5) * side_px
        pieces.append("M" + "L".join(f"{y:.2f} {x:.2f}" for x, y in px) + "Z")
    return "".join(pieces)


def _pieces(outlines_mm: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    gaps = np.flatnonzero(np.isnan(outlines_mm).any(axis=1))
    for piece in np.split(outlines_mm, gaps):
        kept = piece[~np.isnan(piece).any(axis=1)]
        if len(kept):
            yield kept


def _no_finer(values: NDArray[Any]) -> NDArray[np.float32]:
    """Average neighbours so that at most `FINEST` values remain along the axes."""
    height, width = (min(size, most) for size, most in zip(values.shape, FINEST, strict=True))
    whole = Image.fromarray(values.astype(np.float32))
    return np.asarray(whole.resize((width, height), Image.Resampling.BOX))


def _diverging(fractions: NDArray[Any]) -> Image.Image:
    """Draw fractions -1..1 in 65 colours, so that noise compresses well."""
    steps = np.rint(np.clip(fractions, -1.0, 1.0) * 32).astype(int) + 32
    places = np.linspace(0.0, 64.0, len(DIVERGING))
    table = np.stack([np.interp(np.arange(65), places, DIVERGING[:, part]) for part in range(3)], axis=1)
    picture = Image.fromarray(steps.astype(np.uint8))
    picture.putpalette(np.rint(table).astype(np.uint8).tobytes())
    return picture


def _profile(residual: NDArray[Any], *, axis: int) -> Profile:
    """Compute RMS and mean over one axis, cut so that a dead cell does not press all other values to the axis."""
    rms, mean = np.sqrt(np.mean(residual**2, axis=axis)), np.mean(residual, axis=axis)
    high = min(1.05 * float(rms.max()), 3.0 * float(np.percentile(rms, 98.0))) or 1.0
    low = max(1.05 * min(float(mean.min()), 0.0), -high)
    across = (np.arange(len(rms)) + 0.5) / len(rms)

    def line(values: NDArray[Any]) -> str:
        keep = slice(None, None, max(1, len(values) // MOST_POINTS))
        up = (np.clip(values, low, high) - low) / (high - low)
        return _points(zip(across[keep], up[keep], strict=True))

    return Profile(rms=line(rms), mean=line(mean), zero=1000.0 * (1.0 + low / (high - low)), top=f"{high:.2g}")


def _points(places: Any) -> str:  # noqa: ANN401 - any pairs of numbers
    """Convert positions of 0 to 1, larger values up, to SVG points."""
    return " ".join(f"{1000 * x:.1f},{1000 * (1 - y):.1f}" for x, y in places)
