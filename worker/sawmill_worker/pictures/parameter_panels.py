"""Panels of pairs of geometry parameters: the source frame with its ellipses, and theta with its twin."""

import math
from itertools import combinations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure
from matplotlib.patches import Ellipse
from numpy.typing import NDArray

from sawmill_contracts.calibrations import FoundGeometry
from sawmill_contracts.geometry import ThetaDeviation
from sawmill_vocabulary import Theta

ANSWER, TWIN = "#1f77b4", "#b71c1c"
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
# Theta's parameters other than the source shift, in the order of `_shown`.
THETA = (r"first angle $\alpha_0$, °", "$r_D$, mm", "$h_D$, mm", r"tilt $\alpha_D$")


def draw_frame_pairs(figure: SubFigure, covariance: NDArray[np.float64]) -> None:
    """Draw the 95 % ellipse of each pair of source frame parameters, as deviations from the answer.

    Parameters
    ----------
    covariance : (5, 5) float64
        Covariance of (psi, R, SDD, u_c, tau) in rad and mm; a parameter whose row is zero was fixed and is left out.
    """
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
    long, wide = NINETY_FIVE * np.sqrt(np.maximum(powers[::-1], 0.0))
    angle = math.degrees(math.atan2(axes[1, 1], axes[0, 1]))
    ax.add_patch(Ellipse((0, 0), 2 * long, 2 * wide, angle=angle, facecolor=ANSWER, alpha=0.25))
    ax.add_patch(Ellipse((0, 0), 2 * long, 2 * wide, angle=angle, fill=False, edgecolor=ANSWER))
    ax.plot([0], [0], "+", color="black", markersize=6)
    reach = 1.25 * NINETY_FIVE * np.sqrt(np.diag(covariance))
    ax.set_xlim(-reach[0], reach[0])
    ax.set_ylim(-reach[1], reach[1])
    ax.locator_params(nbins=4)


def draw_theta_and_twin(figure: SubFigure, geometry: FoundGeometry) -> None:
    """Draw theta's other parameters against the source shift: the answer, and the twin with the same sinogram."""
    theta, twin, deviation = geometry.theta, geometry.theta_twin, geometry.deviations.theta
    values, spreads = _shown(theta), _spreads(deviation)
    for index, label in enumerate(THETA):
        ax = figure.add_subplot(2, 2, 1 + index)
        ax.errorbar(
            [theta.source_shift_mm],
            [values[index]],
            xerr=deviation.source_shift_mm,
            yerr=spreads[index],
            fmt="o",
            color=ANSWER,
            label="the answer",
        )
        if twin is not None:
            twin_value = _shown(twin)[index]
            ax.plot([twin.source_shift_mm], [twin_value], "s", color=TWIN, fillstyle="none", label="its twin")
        ax.margins(0.25)
        ax.set_ylabel(label)
        ax.ticklabel_format(useOffset=False)
        ax.grid(color="0.9")
        if index >= 2:
            ax.set_xlabel("source shift $h_S$, mm")
        if index == 0:
            ax.legend(fontsize=9)


def _shown(theta: Theta) -> tuple[float, ...]:
    angle_deg = math.degrees(theta.initial_angle_rad)
    return angle_deg, theta.detector_to_cor_mm, theta.detector_shift_mm, theta.detector_tilt


def _spreads(deviation: ThetaDeviation) -> tuple[float | None, ...]:
    angle_rad = deviation.initial_angle_rad
    angle_deg = None if angle_rad is None else math.degrees(angle_rad)
    return angle_deg, deviation.detector_to_cor_mm, deviation.detector_shift_mm, deviation.detector_tilt
