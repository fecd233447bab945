"""How Tikhonov's alpha came to be chosen: the L-curve, and generalised cross-validation where that was asked."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sawmill_worker.pictures.image_panels import encoded

INK, CHOSEN = "#1f77b4", "#b71c1c"
# Points of the curve that are marked, and how far from the last one the next is whose alpha is written beside it.
MARKS, APART_PX = 13, (72.0, 18.0)


def alpha_curve_png(columns: Mapping[str, NDArray[Any]]) -> bytes:
    """The curve of one slice with the alpha that was taken.

    Parameters
    ----------
    columns : mapping of name to array
        `alphas` in mm², `residual_norms`, `solution_norms` and perhaps `gcv`, each (points,), and the `alpha` taken.

    Returns
    -------
    bytes
        A PNG file.
    """
    alphas, alpha = columns["alphas"], float(columns["alpha"])
    panels = 2 if "gcv" in columns else 1
    figure = Figure(figsize=(6.0 * panels, 5.0), layout="constrained")
    left, *right = figure.subplots(1, panels, squeeze=False)[0]
    for axes in right:
        axes.loglog(alphas, columns["gcv"], color=INK)
        axes.axvline(alpha, color=CHOSEN, linestyle="--", label=f"taken: {alpha:.3g} mm²")
        axes.set(xlabel="alpha, mm²", ylabel="GCV", title="generalised cross-validation")
        axes.legend()
    _draw_l_curve(figure, left, columns, alpha)
    return encoded(figure)


def _draw_l_curve(figure: Figure, axes: Axes, columns: Mapping[str, NDArray[Any]], alpha: float) -> None:
    alphas, residual, solution = columns["alphas"], columns["residual_norms"], columns["solution_norms"]
    axes.loglog(residual, solution, color=INK)
    nearest = int(np.argmin(np.abs(np.log(alphas / alpha))))
    axes.margins(x=0.2)
    axes.set(xlabel="||A x - y||", ylabel="||x||", title="L-curve of the middle slice")
    # Where points lie on the page is known once it is laid out.
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
