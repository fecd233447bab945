"""What a calibration looks like: the phantom found, what is left of its sinogram, and the numbers.

Drawn with matplotlib's figure objects, never through pyplot: no state, no display.
A picture's row is +x and its column is +y (DESIGN section 3).
"""

from collections.abc import Sequence
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from numpy.typing import NDArray

from worker.pictures.windows import Window, round_length, window_of

Floats = NDArray[np.floating[Any]]

OUTLINE = "#ff7f0e"
MEAN, RMS = "#1f77b4", "#444444"
VERDICTS = {"pass": "#2e7d32"}
OTHER_VERDICT = "#b71c1c"


def calibration_report_png(
    *,
    image: Floats,
    field_mm: float,
    outlines: Sequence[Floats],
    sinogram: Floats,
    residual: Floats,
    angles_deg: Floats,
    pitch_mm: float,
    table: Sequence[tuple[str, str]],
    verdict: str,
    title: str,
) -> bytes:
    """The report of one calibration on one page.

    Parameters
    ----------
    image : (x, y) float
        The phantom's reconstruction with the geometry found.
    field_mm : float
        Side of the image.
    outlines : sequence of (n, 2) float, mm
        The phantom's outlines as (x, y), where the calibration put them.
    sinogram, residual : (views, detector) float
        Measured, and measured less model, in the same unit.
    angles_deg : (views,) float
        Each view's angle.
    pitch_mm : float
        Distance between detector cells.
    table : sequence of (label, value)
        The result, ready to be read.
    verdict : str
        `pass` is green, everything else is red.
    title : str
        One line above.

    Returns
    -------
    bytes
        A PNG file.

    Raises
    ------
    ValueError
        When residual and sinogram, or views and angles, do not agree.
    """
    if residual.shape != sinogram.shape or len(angles_deg) != len(sinogram):
        raise ValueError(
            f"the residual {residual.shape}, the sinogram {sinogram.shape} and {len(angles_deg)} angles do not agree"
        )
    spacing = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.12, hspace=0.03, wspace=0.03)
    figure = Figure(figsize=(14.0, 11.2), layout=spacing)
    figure.suptitle(title, fontsize=17, fontweight="bold", x=0.012, ha="left")
    color = VERDICTS.get(verdict, OTHER_VERDICT)
    badge = {"boxstyle": "round,pad=0.45", "facecolor": color, "edgecolor": "none"}
    figure.text(
        0.985, 0.985, verdict.upper(), fontsize=15, fontweight="bold", color="white", ha="right", va="top", bbox=badge
    )
    grid = figure.add_gridspec(2, 2, width_ratios=(1, 1.12), height_ratios=(1.12, 1))
    _draw_overlay(figure, figure.add_subplot(grid[0, 0]), image, field_mm, outlines)
    _draw_residual(
        figure,
        figure.add_subplot(grid[0, 1]),
        sinogram=sinogram,
        residual=residual,
        angles_deg=angles_deg,
        pitch_mm=pitch_mm,
    )
    _draw_table(figure.add_subplot(grid[1, 0]), table)
    profiles = grid[1, 1].subgridspec(2, 1)
    views_axes, cells_axes = figure.add_subplot(profiles[0]), figure.add_subplot(profiles[1])
    order = np.argsort(angles_deg, kind="stable")
    _draw_profile(views_axes, angles_deg[order], residual[order], axis=1, label="angle of the view, degrees")
    _draw_profile(
        cells_axes, _cells_mm(residual.shape[1], pitch_mm), residual, axis=0, label="position on the detector, mm"
    )
    views_axes.set_title("residual by view and by cell", loc="left")
    views_axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, frameon=False)
    return _encoded(figure)


def overlay_png(*, image: Floats, field_mm: float, outlines: Sequence[Floats], title: str) -> bytes:
    """The reconstruction with the phantom's outlines over it, alone; arguments as for the report."""
    figure = Figure(figsize=(9.0, 8.2), layout="constrained")
    figure.suptitle(title, fontsize=15, fontweight="bold")
    _draw_overlay(figure, figure.add_subplot(), image, field_mm, outlines)
    return _encoded(figure)


def log_comparison_png(
    *, before: Floats, after: Floats, field_mm: float, titles: tuple[str, str], unit: str = ""
) -> bytes:
    """Two reconstructions of one log, side by side in one grey window.

    Parameters
    ----------
    before, after : (x, y) float
        With the nominal and with the calibrated geometry.
    field_mm : float
        Side of both images.
    titles : (str, str)
        One line above each.
    unit : str
        Of the values, for the colour bar.
    """
    figure = Figure(figsize=(15.0, 7.4), layout="constrained")
    window = window_of(after)
    axes = [figure.add_subplot(1, 2, index) for index in (1, 2)]
    for ax, image, title in zip(axes, (before, after), titles, strict=True):
        shown = _show_image(ax, image, field_mm, window)
        _draw_scale_bar(ax, field_mm)
        ax.set_title(title, fontsize=14)
    figure.colorbar(shown, ax=axes, label=unit, shrink=0.9, pad=0.015)
    return _encoded(figure)


def _show_image(ax: Axes, image: Floats, field_mm: float, window: Window) -> Any:  # noqa: ANN401 - matplotlib's AxesImage
    half = field_mm / 2
    shown = ax.imshow(
        image, cmap="gray", vmin=window[0], vmax=window[1], extent=(-half, half, half, -half), interpolation="nearest"
    )
    ax.set_xlabel("y, mm")
    ax.set_ylabel("x, mm")
    return shown


def _draw_overlay(figure: Figure, ax: Axes, image: Floats, field_mm: float, outlines: Sequence[Floats]) -> None:
    shown = _show_image(ax, image, field_mm, window_of(image))
    for index, outline in enumerate(outlines):
        closed = np.concatenate([outline, outline[:1]])
        ax.plot(closed[:, 1], closed[:, 0], color=OUTLINE, linewidth=1.4, label="phantom" if index == 0 else None)
    if outlines:
        ax.legend(loc="upper right", framealpha=0.85)
    ax.set_title("reconstruction, the phantom's outline over it")
    figure.colorbar(shown, ax=ax, shrink=0.85, pad=0.02)


def _draw_residual(
    figure: Figure, ax: Axes, *, sinogram: Floats, residual: Floats, angles_deg: Floats, pitch_mm: float
) -> None:
    views, cells = residual.shape
    limit = float(np.percentile(np.abs(residual), 99.5)) or 1.0
    half_mm = cells * pitch_mm / 2
    shown = ax.imshow(
        residual,
        cmap="RdBu_r",
        vmin=-limit,
        vmax=limit,
        aspect="auto",
        extent=(-half_mm, half_mm, views - 0.5, -0.5),
        interpolation="nearest",
    )
    # The rows are views, which need not be equidistant: each label is its own view's angle.
    marked = np.unique(np.linspace(0, views - 1, min(views, 7)).round().astype(int))
    ax.set_yticks(marked, [f"{angles_deg[view]:.4g}" for view in marked])
    ax.set_ylabel("angle of the view, degrees")
    ax.set_xlabel("position on the detector, mm")
    # Against the sinogram without its mean, as the result says it: a background explains nothing.
    rms, whole = _rms(residual), float(np.std(sinogram, dtype=np.float64))
    share = f", {100 * rms / whole:.2g} % of the sinogram's" if whole else ""
    ax.set_title(f"measured less model, RMS {rms:.3g}{share}")
    figure.colorbar(shown, ax=ax, shrink=0.85, pad=0.02, extend="both")


def _draw_profile(ax: Axes, positions: Floats, residual: Floats, *, axis: int, label: str) -> None:
    ax.axhline(0, color="0.75", linewidth=0.8)
    ax.plot(positions, np.sqrt(np.mean(residual**2, axis=axis)), color=RMS, linewidth=1.0, label="RMS")
    ax.plot(positions, np.mean(residual, axis=axis), color=MEAN, linewidth=1.2, label="mean")
    ax.set_xlabel(label)
    ax.margins(x=0.01)
    ax.spines[["top", "right"]].set_visible(False)


def _draw_table(ax: Axes, table: Sequence[tuple[str, str]]) -> None:
    ax.set_axis_off()
    step = 1 / max(len(table), 14)
    for line, (label, value) in enumerate(table):
        y = 1 - (line + 0.5) * step
        if line % 2 == 0:
            ax.axhspan(y - step / 2, y + step / 2, color="0.95", linewidth=0)
        ax.text(0.02, y, label, va="center", fontsize=11)
        ax.text(0.98, y, value, va="center", ha="right", fontsize=11, family="monospace")
    ax.set_xlim(0, 1)
    ax.set_ylim(0, 1)


def _draw_scale_bar(ax: Axes, field_mm: float) -> None:
    length, half = round_length(field_mm / 4), field_mm / 2
    left, below = -half + 0.05 * field_mm, half - 0.06 * field_mm
    ax.plot([left, left + length], [below, below], color="white", linewidth=4, solid_capstyle="butt")
    ax.text(left + length / 2, below - 0.02 * field_mm, f"{length:g} mm", color="white", ha="center", fontsize=11)


def _cells_mm(cells: int, pitch_mm: float) -> NDArray[np.float64]:
    # u_m = (m + 1/2 - n_D/2) pitch, DESIGN section 3.
    return (np.arange(cells, dtype=np.float64) + 0.5 - cells / 2) * pitch_mm


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64))))


def _encoded(figure: Figure) -> bytes:
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=100)
    return stream.getvalue()
