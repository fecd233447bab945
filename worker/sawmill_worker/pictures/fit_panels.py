"""Panels on a calibration's fit: the residual with its profiles, and the convergence of the search."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure
from numpy.typing import NDArray

from sawmill_worker.pictures.windows import labelled_views

MEAN, RMS = "#1f77b4", "#444444"
# Cut of a profile, as a multiple of its 98th percentile: a dead cell would press all other values to the axis.
TALLEST = 3.0


def draw_residual(figure: SubFigure, residual: NDArray[Any], angles_deg: NDArray[Any], pitch_mm: float) -> None:
    """Draw measured minus model, with the profile over the views at the side and over the cells below.

    Parameters
    ----------
    residual : (views, detector) float
        The residual, in the unit of the sinogram.
    angles_deg : (views,) float
        Each view's angle.
    pitch_mm : float
        Distance between detector cells.
    """
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
    image_ax.set_ylabel("angle of the view, degrees")
    image_ax.tick_params(labelbottom=False)
    figure.colorbar(shown, ax=image_ax, location="left", shrink=0.85, pad=0.02, extend="both")
    by_view = figure.add_subplot(grid[0, 1], sharey=image_ax)
    _draw_profile(by_view, np.arange(views), residual, axis=1)
    by_view.tick_params(labelleft=False)
    by_view.set_title("by view", fontsize=10)
    # u_m = (m + 1/2 - n_D/2) pitch, docs/look-up/conventions.md#axes.
    by_cell = figure.add_subplot(grid[1, 0], sharex=image_ax)
    _draw_profile(by_cell, (np.arange(cells) + 0.5 - cells / 2) * pitch_mm, residual, axis=0)
    by_cell.set_xlabel("position on the detector, mm")
    by_cell.set_ylabel("by cell", fontsize=10)
    legend_ax = figure.add_subplot(grid[1, 1])
    legend_ax.set_axis_off()
    legend_ax.legend(*by_cell.get_legend_handles_labels(), loc="center", frameon=False)


def _draw_profile(ax: Axes, positions: NDArray[Any], residual: NDArray[Any], *, axis: int) -> None:
    rms, mean = np.sqrt(np.mean(residual**2, axis=axis)), np.mean(residual, axis=axis)
    highest = min(1.05 * float(rms.max()), TALLEST * float(np.percentile(rms, 98.0))) or 1.0
    lowest = max(1.05 * min(float(mean.min()), 0.0), -highest)
    upright = axis == 1
    for values, color, label in ((rms, RMS, "RMS"), (mean, MEAN, "mean")):
        ax.plot(*((values, positions) if upright else (positions, values)), color=color, linewidth=1.1, label=label)
    (ax.axvline if upright else ax.axhline)(0, color="0.75", linewidth=0.8)
    (ax.set_xlim if upright else ax.set_ylim)(lowest, highest)
    ax.spines[["top", "right"]].set_visible(False)


def draw_search(ax: Axes, history: NDArray[Any], *, final: float | None) -> None:
    """Draw the best value over the evaluations of a search.

    Parameters
    ----------
    history : (steps, 2) float
        Evaluations made and the best value so far.
    final : float or None
        Relative residual after least squares on all the data, where the values are relative residuals too.
    """
    evaluations, best = history[:, 0], history[:, 1]
    ax.step(evaluations, best, where="post", color=MEAN, marker="o", markersize=3.5, label="best so far, coarse data")
    if final is not None:
        ax.axhline(final, color=RMS, linestyle="--", linewidth=1.0, label="after least squares on all the data")
        ax.set_yscale("log")
        ax.legend(frameon=False, fontsize=9)
    ax.set_xlabel("evaluations")
    ax.set_ylabel("relative residual" if final is not None else "objective")
    ax.spines[["top", "right"]].set_visible(False)
