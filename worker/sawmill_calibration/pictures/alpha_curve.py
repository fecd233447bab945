"""Choice of Tikhonov's alpha: the L-curve, and generalised cross-validation where it was requested."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sawmill_calibration.pictures.panels import encoded

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
