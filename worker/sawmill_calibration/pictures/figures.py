"""Figures: a sinogram, a slice, a drift check, the curve from which alpha was chosen; drawn without pyplot."""

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sawmill_calibration.pictures.pages import Window, labelled_views, window_of
from sawmill_calibration.pictures.panels import encoded, show_image
from sawmill_contracts.drifts import DriftResult

# A change beyond this number of standard deviations is a move (contracts.drifts.DriftResult.moved).
SIGNIFICANT = 3.0
DETECTOR_PARAMETERS = {
    "cor_column_mm": "COR on the detector, mm",
    "tilt_rad": "tilt of the detector, rad",
    "source_to_detector_mm": "source to detector, mm",
}


def sinogram_figure(
    sinogram: NDArray[np.floating[Any]], *, angles_deg: NDArray[np.float64], pitch_mm: float, title: str
) -> Figure:
    """Draw a sinogram (views, cells): views downwards with their angles in degrees, the detector to the right in mm."""
    views, cells = sinogram.shape
    figure = Figure(figsize=(8.0, 5.6), layout="constrained")
    ax = figure.add_subplot()
    half, window = cells * pitch_mm / 2, window_of(sinogram)
    extent = (-half, half, views - 0.5, -0.5)
    shown = ax.imshow(
        sinogram, cmap="gray", vmin=window[0], vmax=window[1], extent=extent, aspect="auto", interpolation="nearest"
    )
    ax.set_yticks(*zip(*labelled_views(angles_deg), strict=True))
    ax.set(xlabel="position on the detector, mm", ylabel="angle of the view, degrees", title=title)
    figure.colorbar(shown, ax=ax, label="line integral")
    return figure


def slice_figure(
    image: NDArray[np.floating[Any]],
    *,
    field_mm: float,
    centre_mm: tuple[float, float],
    unit: str,
    window: Window,
    title: str,
) -> Figure:
    """Draw a slice (x, y) in mm, x downwards and y to the right (docs/look-up/conventions.md#axes)."""
    figure = Figure(figsize=(6.8, 5.8), layout="constrained")
    ax = figure.add_subplot()
    shown = show_image(ax, image, field_mm, window, centre_mm=centre_mm)
    ax.set_title(title)
    figure.colorbar(shown, ax=ax, label=unit, shrink=0.9)
    return figure


def drift_figure(result: DriftResult) -> Figure:
    """Draw each parameter's change with three standard deviations; leave out parameters that the scan does not show."""
    deviation = result.change_standard_deviation
    shown = [name for name in DETECTOR_PARAMETERS if getattr(deviation, name) is not None]
    figure = Figure(figsize=(8.0, 1.2 + 1.0 * len(shown)), layout="constrained")
    figure.suptitle(
        f"change since the calibration, ± {SIGNIFICANT:g} standard deviations\n"
        f"rays moved {result.ray_change_mm:.2g} mm, tolerance {result.tolerance_mm:.2g} mm"
    )
    for ax, name in zip(np.atleast_1d(figure.subplots(len(shown), 1)), shown, strict=True):
        change, reach = getattr(result.change, name), SIGNIFICANT * getattr(deviation, name)
        ax.errorbar([change], [0.0], xerr=[reach], fmt="o", capsize=5)
        ax.axvline(0.0, color="0.6", linewidth=1.0)
        ax.set(yticks=[], xlabel=DETECTOR_PARAMETERS[name])
    return figure


Array = NDArray[np.float64]

INK, CHOSEN = "#1f77b4", "#b71c1c"
# Number of marked points of the curve, and least distance between two points that are labelled with alpha.
MARKS, APART_PX = 13, (72.0, 18.0)


def alpha_curve_png(
    *, alphas: Array, residual_norms: Array, solution_norms: Array, alpha: Array, gcv: Array | None = None
) -> bytes:
    """Draw the curve of one slice with the chosen alpha.

    Parameters
    ----------
    alphas : (points,) float64
        Values of alpha, mm².
    residual_norms, solution_norms : (points,) float64
        ||A x - y|| and ||x||.
    alpha : () float64
        The chosen alpha, mm².
    gcv : (points,) float64, optional
        Generalised cross-validation, where it was requested.

    Returns
    -------
    bytes
        A PNG file.
    """
    chosen = float(alpha)
    figure = Figure(figsize=(6.0 if gcv is None else 12.0, 5.0), layout="constrained")
    l_curve, *right = figure.subplots(1, 1 if gcv is None else 2, squeeze=False)[0]
    for axes in right:
        axes.loglog(alphas, gcv, color=INK)
        axes.axvline(chosen, color=CHOSEN, linestyle="--", label=f"taken: {chosen:.3g} mm²")
        axes.set(xlabel="alpha, mm²", ylabel="GCV", title="generalised cross-validation")
        axes.legend()
    _draw_l_curve(figure, l_curve, alphas, residual_norms, solution_norms, chosen)
    return encoded(figure)


def _draw_l_curve(figure: Figure, axes: Axes, alphas: Array, residual: Array, solution: Array, alpha: float) -> None:
    axes.loglog(residual, solution, color=INK)
    nearest = int(np.argmin(np.abs(np.log(alphas / alpha))))
    axes.margins(x=0.2)
    axes.set(xlabel="||A x - y||", ylabel="||x||", title="L-curve of the middle slice")
    # The positions of points on the page are known only after the page is laid out.
    figure.draw_without_rendering()
    marked = (math.inf, math.inf)
    for index in np.linspace(0, alphas.size - 1, MARKS).round().astype(int):
        axes.plot(residual[index], solution[index], ".", color=INK)
        place = axes.transData.transform((residual[index], solution[index]))
        if any(abs(a - b) > apart for a, b, apart in zip(place, marked, APART_PX, strict=True)):
            axes.annotate(
                f"{alphas[index]:.1e}", (residual[index], solution[index]), (6, 4), textcoords="offset points"
            )
            marked = tuple(place)
    axes.plot(residual[nearest], solution[nearest], "o", color=CHOSEN, label=f"taken: alpha = {alpha:.3g} mm²")
    axes.legend()
