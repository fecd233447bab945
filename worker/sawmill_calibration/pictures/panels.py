"""Panels of a calibration's report, which a picture and the printable page share.

Panels are drawn with matplotlib's figure objects, never through pyplot, so that there is no state and no display. A
picture's row is +x and its column is +y (docs/look-up/conventions.md#axes).
"""

import math
from io import BytesIO
from itertools import combinations
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from matplotlib.image import AxesImage
from matplotlib.patches import Ellipse
from matplotlib.ticker import Formatter
from numpy.typing import NDArray

from sawmill_calibration.pictures.pages import LOG_WINDOW, Window, labelled_views, window_of
from sawmill_calibration.pictures.round_numbers import round_length
from sawmill_contracts.calibrations import FoundGeometry
from sawmill_vocabulary import Theta
from sawmill_vocabulary.messages import ENGLISH, N_, Reader

Array = NDArray[Any]

OUTLINE, ANSWER, RMS, TWIN = "#ff7f0e", "#1f77b4", "#444444", "#b71c1c"
# Cut of a profile, as a multiple of its 98th percentile: a dead cell would press all other values to the axis.
TALLEST = 3.0
# Half axis of an ellipse that holds 95 % of a normal distribution in two dimensions, in standard deviations.
NINETY_FIVE = math.sqrt(-2.0 * math.log(0.05))
# In the order of the covariance: symbol, unit of the axis, and the size of this unit in the covariance's unit.
FRAME = (
    (r"$\psi$", "0.001°", math.radians(1e-3)),
    ("R", "mm", 1.0),
    ("SDD", "mm", 1.0),
    (r"$u_c$", "mm", 1.0),
    (r"$\tau$", "0.001°", math.radians(1e-3)),
)
# Theta's parameters other than the source shift, in the order of `_four`.
THETA = (r"$\alpha_0$, °", "$r_D$, mm", "$h_D$, mm", r"tan $\alpha_D$")


def encoded(figure: Figure, file_format: str = "png") -> bytes:
    """Encode the figure as a PNG or an SVG file; equal figures give equal bytes."""
    stream, date = BytesIO(), {"Date": None} if file_format == "svg" else {}
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "sawmill"}):
        figure.savefig(stream, format=file_format, dpi=100, metadata=date)
    return stream.getvalue()


class _Localised(Formatter):
    """Formatter that writes the labels of another one with the decimal mark of a language."""

    def __init__(self, inner: Formatter, reader: Reader) -> None:
        self._inner, self._reader = inner, reader

    def set_axis(self, axis: Any) -> None:  # noqa: ANN401 - as matplotlib has it
        """Take the axis, for the inner formatter too."""
        super().set_axis(axis)
        self._inner.set_axis(axis)

    def __call__(self, value: float, position: int | None = None) -> str:
        return self._reader.localised(self._inner(value, position))

    def format_ticks(self, values: Any) -> list[str]:  # noqa: ANN401 - as matplotlib has it
        """Write the values of all ticks, which the inner formatter sees together."""
        return [self._reader.localised(text) for text in self._inner.format_ticks(values)]

    def get_offset(self) -> str:
        """Write the offset of all ticks."""
        return self._reader.localised(self._inner.get_offset())


def localise(figure: Figure, reader: Reader) -> None:
    """Write the numbers at all axes of a figure with the decimal mark of the reader's language."""
    for ax in figure.get_axes() if reader is not ENGLISH else ():
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_formatter(_Localised(axis.get_major_formatter(), reader))
            axis.set_minor_formatter(_Localised(axis.get_minor_formatter(), reader))


def show_image(
    ax: Axes, image: Array, field_mm: float, window: Window, centre_mm: tuple[float, float] = (0.0, 0.0)
) -> AxesImage:
    """Show an image (x, y) in mm, the rotation centre at the origin; `centre_mm` is (x, y) of the field's centre."""
    half, (x, y) = field_mm / 2, centre_mm
    extent = (y - half, y + half, x + half, x - half)
    shown = ax.imshow(image, cmap="gray", vmin=window[0], vmax=window[1], extent=extent, interpolation="nearest")
    ax.set(xlabel="y, mm", ylabel="x, mm")
    return shown


def draw_phantom(
    figure: FigureBase, ax: Axes, image: Array, field_mm: float, outlines: Array, reader: Reader = ENGLISH
) -> None:
    """Draw a reconstruction (x, y), 0 where there is none, and closed outlines (points, 2), mm, NaN between two."""
    shown = show_image(ax, image, field_mm, window_of(image, *LOG_WINDOW))
    if len(outlines):
        ax.plot(outlines[:, 1], outlines[:, 0], color=OUTLINE, linewidth=1.4)
    if not image.any():
        missing = reader.words(N_("No image: the views do not go all round."))
        ax.text(0.5, 0.5, missing, transform=ax.transAxes, ha="center", color="white", wrap=True)
    figure.colorbar(shown, ax=ax, shrink=0.85, pad=0.02)


def draw_log(ax: Axes, image: Array, field_mm: float, window: Window) -> AxesImage:
    """Draw a reconstruction (x, y) of a log with a scale bar."""
    shown = show_image(ax, image, field_mm, window)
    length, half = round_length(field_mm / 4), field_mm / 2
    left, below = -half + 0.05 * field_mm, half - 0.06 * field_mm
    ax.plot([left, left + length], [below, below], color="white", linewidth=4, solid_capstyle="butt")
    ax.text(left + length / 2, below - 0.02 * field_mm, f"{length:g} mm", color="white", ha="center", fontsize=11)
    return shown


def draw_residual(figure: FigureBase, residual: Array, angles_deg: Array, pitch_mm: float, reader: Reader) -> None:
    """Draw measured minus model (views, detector), with the profile over the views and over the cells."""
    views, cells = residual.shape
    half_mm = cells * pitch_mm / 2
    grid = figure.add_gridspec(2, 2, width_ratios=(3.2, 1), height_ratios=(2.4, 1))
    image_ax = figure.add_subplot(grid[0, 0])
    limit = float(np.percentile(np.abs(residual), 99.5)) or 1.0
    shown = image_ax.imshow(
        residual,
        cmap="RdBu_r",
        vmin=-limit,
        vmax=limit,
        aspect="auto",
        extent=(-half_mm, half_mm, views - 0.5, -0.5),
        interpolation="nearest",
    )
    image_ax.set_yticks(*zip(*labelled_views(angles_deg), strict=True))
    image_ax.set_ylabel(reader.words(N_("angle of the view, degrees")))
    image_ax.tick_params(labelbottom=False)
    figure.colorbar(shown, ax=image_ax, location="left", shrink=0.85, pad=0.02, extend="both")
    by_view = figure.add_subplot(grid[0, 1], sharey=image_ax)
    _draw_profile(by_view, np.arange(views), residual, axis=1)
    by_view.tick_params(labelleft=False)
    # u_m = (m + 1/2 - n_D/2) pitch, docs/look-up/conventions.md#axes.
    by_cell = figure.add_subplot(grid[1, 0], sharex=image_ax)
    lines = _draw_profile(by_cell, (np.arange(cells) + 0.5 - cells / 2) * pitch_mm, residual, axis=0)
    by_cell.set_xlabel(reader.words(N_("position on the detector, mm")))
    legend_ax = figure.add_subplot(grid[1, 1])
    legend_ax.set_axis_off()
    legend_ax.legend(lines, ("RMS", reader.words(N_("mean"))), loc="center", frameon=False)


def _draw_profile(ax: Axes, positions: Array, residual: Array, *, axis: int) -> list[Any]:
    """Draw RMS and mean over an axis of the residual, and return both lines."""
    rms, mean = np.sqrt(np.mean(residual**2, axis=axis)), np.mean(residual, axis=axis)
    highest = min(1.05 * float(rms.max()), TALLEST * float(np.percentile(rms, 98.0))) or 1.0
    upright = axis == 1
    lines = [
        ax.plot(*((values, positions) if upright else (positions, values)), color=color, linewidth=1.1)[0]
        for values, color in ((rms, RMS), (mean, ANSWER))
    ]
    (ax.axvline if upright else ax.axhline)(0, color="0.75", linewidth=0.8)
    (ax.set_xlim if upright else ax.set_ylim)(max(1.05 * min(float(mean.min()), 0.0), -highest), highest)
    ax.spines[["top", "right"]].set_visible(False)
    return lines


def draw_search(figure: FigureBase, history: Array, final: float, reader: Reader) -> None:
    """Draw the best value over the evaluations of a search."""
    ax = figure.add_subplot()
    best = reader.words(N_("best so far, coarse data"))
    ax.step(*history.T, where="post", color=ANSWER, marker="o", markersize=3.5, label=best)
    if (history[:, 1] > 0.0).all():
        fitted = reader.words(N_("after least squares on all the data"))
        ax.axhline(final, color=RMS, linestyle="--", linewidth=1.0, label=fitted)
        ax.set_yscale("log")
    ax.legend(frameon=False, fontsize=9)
    ax.set_xlabel(reader.words(N_("evaluations")))
    ax.spines[["top", "right"]].set_visible(False)


def draw_frame_pairs(figure: FigureBase, covariance: NDArray[np.float64]) -> None:
    """Draw the 95 % ellipse of each pair of (psi, R, SDD, u_c, tau), rad and mm; one with variance 0 was fixed."""
    free = [index for index in range(len(FRAME)) if covariance[index, index] > 0.0]
    scale = np.array([FRAME[index][2] for index in free])
    shown = covariance[np.ix_(free, free)] / np.outer(scale, scale)
    last = len(free) - 1
    grid = figure.add_gridspec(last, last)
    for column, row in combinations(range(len(free)), 2):
        ax = figure.add_subplot(grid[row - 1, column])
        _draw_ellipse(ax, shown[np.ix_([column, row], [column, row])])
        ax.tick_params(labelsize=8, labelbottom=row == last, labelleft=column == 0)
        if row == last:
            ax.set_xlabel("{}, {}".format(*FRAME[free[column]]), fontsize=10)
        if column == 0:
            ax.set_ylabel("{}, {}".format(*FRAME[free[row]]), fontsize=10)


def _draw_ellipse(ax: Axes, covariance: NDArray[np.float64]) -> None:
    powers, axes = np.linalg.eigh(covariance)
    long, wide = 2 * NINETY_FIVE * np.sqrt(np.maximum(powers[::-1], 0.0))
    angle = math.degrees(math.atan2(axes[1, 1], axes[0, 1]))
    ax.add_patch(Ellipse((0, 0), long, wide, angle=angle, facecolor=ANSWER, alpha=0.25))
    ax.add_patch(Ellipse((0, 0), long, wide, angle=angle, fill=False, edgecolor=ANSWER))
    ax.plot([0], [0], "+", color="black", markersize=6)
    reach = 1.25 * NINETY_FIVE * np.sqrt(np.diag(covariance))
    ax.set(xlim=(-reach[0], reach[0]), ylim=(-reach[1], reach[1]))
    ax.locator_params(nbins=4)


def draw_theta_and_twin(figure: FigureBase, geometry: FoundGeometry, reader: Reader) -> None:
    """Draw theta's other parameters against the source shift: the answer, and the twin with the same sinogram."""
    theta, twin, deviation = geometry.theta, geometry.theta_twin, geometry.deviations.theta
    angle_rad = deviation.initial_angle_rad
    spreads = (
        None if angle_rad is None else math.degrees(angle_rad),
        deviation.detector_to_cor_mm,
        deviation.detector_shift_mm,
        deviation.detector_tilt,
    )
    for index, (label, value, spread) in enumerate(zip(THETA, _four(theta), spreads, strict=True)):
        ax = figure.add_subplot(2, 2, 1 + index)
        answer: dict[str, Any] = {"fmt": "o", "color": ANSWER, "label": reader.words(N_("the answer"))}
        ax.errorbar([theta.source_shift_mm], [value], xerr=deviation.source_shift_mm, yerr=spread, **answer)
        if twin is not None:
            hollow: dict[str, Any] = {"color": TWIN, "fillstyle": "none", "label": reader.words(N_("its twin"))}
            ax.plot([twin.source_shift_mm], [_four(twin)[index]], "s", **hollow)
        ax.margins(0.25)
        ax.set_ylabel(label)
        ax.ticklabel_format(useOffset=False)
        ax.grid(color="0.9")
        if index >= 2:
            ax.set_xlabel("$h_S$, mm")
        if index == 0:
            ax.legend(fontsize=9)


def _four(theta: Theta) -> tuple[float, ...]:
    return math.degrees(theta.initial_angle_rad), theta.detector_to_cor_mm, theta.detector_shift_mm, theta.detector_tilt
