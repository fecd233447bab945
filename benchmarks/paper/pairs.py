"""The pair plots: where the published search ends in many runs, and where the product's does."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from scanners import SCANNER
from scans import TRUE_FRAME, TRUE_THETA

from paper import pictures
from paper.experiment import Experiment, Plan, Results, Unit, Values
from paper.printed import shift_range
from paper.searches import default_source, default_unit, paper_unit
from sawmill_tomography.geometry.geometry import FloatArray, Theta, to_vector

PHANTOM = "l-shape"
LABELS = ("initial angle, rad", "detector to COR, mm", "source shift, mm", "detector shift, mm", "detector tilt, slope")
FRAME_LABELS = ("psi, degrees", "R, mm", "SDD, mm", "COR on detector, mm", "tilt, degrees")
TO_DEGREES = np.array([math.degrees(1.0), 1.0, 1.0, 1.0, math.degrees(1.0)])


@dataclass(frozen=True)
class Marker:
    """The style of one kind of point."""

    label: str
    shape: str
    size: float
    colour: str
    filled: bool


MARKERS = {
    "curve's twins": Marker("the runs' twins", "o", 3.0, pictures.SKY, filled=False),
    "curve": Marker("paper, {runs} runs", "o", 4.0, pictures.ORANGE, filled=False),
    "found": Marker("default", "s", 6.0, pictures.BLUE, filled=True),
    "twin": Marker("default's twin", "D", 5.0, pictures.BLUE, filled=False),
    "truth": Marker("truth", "+", 11.0, pictures.BLACK, filled=True),
}


def curve_units(plan: Plan, views: int) -> list[Unit]:
    """List the `paper` method's runs."""
    runs = plan.dense_runs if views == plan.dense_views else plan.sparse_runs
    return [paper_unit(plan, PHANTOM, default_source(), views, seed) for seed in range(runs)]


def _one(views: int) -> Unit:
    """Return the unit of the product on the same scan as the published search."""
    return default_unit(PHANTOM, default_source(), views, 0)


def cloud_units(plan: Plan, views: int) -> list[Unit]:
    """List the product's runs, each on different noise."""
    return [default_unit(PHANTOM, "simulated", views, seed) for seed in range(plan.noise_seeds)]


def units(plan: Plan) -> list[Unit]:
    """List the units of both methods at both numbers of views, and of the product on the published search's scan."""
    return [
        unit
        for views in (plan.sparse_views, plan.dense_views)
        for unit in (
            *cloud_units(plan, views),
            _one(views),
            *curve_units(plan, views),
        )
    ]


def thetas(results: Results, wanted: list[Unit]) -> FloatArray:
    """Collect theta of each of the units, (runs, 5)."""
    return np.array([results[unit.name]["theta"] for unit in wanted])


def twins(points: FloatArray) -> FloatArray:
    """Compute the exact twin of each theta, (points, 5)."""
    made = [to_vector(Theta.from_vector(point).twin(SCANNER.source_to_cor_mm)) for point in points]
    return np.array(made).reshape(-1, 5)


def pair_grid(points: dict[str, FloatArray], path: Path, title: str) -> None:
    """Draw every pair of theta: `curve`, its twins, `found`, `twin` and `truth`, each (points, 5)."""
    drawn = pictures.figure(9.0, 8.6)
    grid = drawn.subplots(4, 4, squeeze=False)
    for row in range(4):
        for column in range(4):
            if column > row:
                grid[row, column].axis("off")
            else:
                _pair(grid[row, column], points, column, row + 1, last=row == 3)
    handles, names = grid[0, 0].get_legend_handles_labels()
    drawn.legend(handles, names, loc="upper right", bbox_to_anchor=(0.98, 0.93), fontsize=10, frameon=False)
    drawn.suptitle(title, fontsize=11)
    pictures.save(drawn, path)


def _pair(axes: Axes, points: dict[str, FloatArray], x: int, y: int, *, last: bool) -> None:
    for name, marker in MARKERS.items():
        at = points[name]
        if len(at):
            label = marker.label.format(runs=len(at))
            face = marker.colour if marker.filled else "none"
            axes.plot(
                at[:, x], at[:, y], marker.shape, ms=marker.size, mfc=face, mew=1.3, color=marker.colour, label=label
            )
    axes.tick_params(labelsize=7)
    axes.margins(0.12)
    if last:
        axes.set_xlabel(LABELS[x], fontsize=8)
    if x == 0:
        axes.set_ylabel(LABELS[y], fontsize=8)


def curve_points(plan: Plan, results: Results, views: int) -> dict[str, FloatArray]:
    """Collect the points that `pair_grid` draws."""
    found = results[_one(views).name]
    curve = thetas(results, curve_units(plan, views))
    return {
        "curve": curve,
        "curve's twins": twins(curve),
        "found": np.array([found["theta"]]),
        "twin": np.array([found["twin"]]),
        "truth": to_vector(TRUE_THETA)[None],
    }


def _close_up(plan: Plan, results: Results, path: Path) -> None:
    """Draw the product's answers under their own magnification, with the ellipse that one of them predicts."""
    drawn = pictures.figure(9.0, 6.0)
    pairs = ((1, 2), (3, 4), (0, 3))
    for row, views in enumerate((plan.dense_views, plan.sparse_views)):
        runs = [results[unit.name] for unit in cloud_units(plan, views)]
        errors = np.array([run["frame"] for run in runs]) - to_vector(TRUE_FRAME)
        errors[:, 0] = np.remainder(errors[:, 0] + np.pi, 2.0 * np.pi) - np.pi
        covariance = np.array(runs[0]["covariance"]) * np.outer(TO_DEGREES, TO_DEGREES)
        for column, pair in enumerate(pairs):
            axes = drawn.add_subplot(2, 3, 3 * row + column + 1)
            at = np.array(pair)
            outline = pictures.ellipse(np.zeros(2), covariance[np.ix_(at, at)])
            axes.plot(outline[:, 0], outline[:, 1], color=pictures.GREEN, label="predicted, 95 %")
            points = (errors * TO_DEGREES)[:, at]
            axes.plot(points[:, 0], points[:, 1], ".", ms=5, color=pictures.BLUE, label=f"{len(runs)} noisy scans")
            axes.plot(0.0, 0.0, "+", ms=11, mew=1.5, color=pictures.BLACK, label="truth")
            axes.set_xlabel("error of " + FRAME_LABELS[pair[0]], fontsize=8)
            axes.set_ylabel("error of " + FRAME_LABELS[pair[1]], fontsize=8)
            axes.set_title(f"{views} views", fontsize=9)
            axes.tick_params(labelsize=7)
            axes.ticklabel_format(style="plain", useOffset=False)
    handles, names = drawn.axes[0].get_legend_handles_labels()
    drawn.legend(handles, names, loc="outside lower center", ncols=3, fontsize=9, frameon=False)
    pictures.save(drawn, path)


HEADER = (
    "views",
    "method and scan",
    "runs",
    f"source shift, mm (truth {TRUE_THETA.source_shift_mm:.1f})",
    "median ray error, mm",
    "largest ray error, mm",
    "largest psi error, deg",
)


def _spread(plan: Plan, results: Results, views: int) -> list[list[str]]:
    """Return one row for each method."""
    source = default_source()
    rows = []
    for name, made in (
        (f"`paper`, {source} scan", curve_units(plan, views)),
        (f"`default`, {source} scan", [_one(views)]),
        ("`default`, simulated, 2 % noise", cloud_units(plan, views)),
    ):
        runs = [results[unit.name] for unit in made]
        shift = [run["theta"][2] for run in runs]
        error = [run["ray_error_mm"] for run in runs]
        psi = max(abs(run["psi_error_deg"]) for run in runs)
        shifts = f"{min(shift):.1f} to {max(shift):.1f}" if len(runs) > 1 else f"{shift[0]:.1f}"
        figures = [f"{np.median(error):.4f}", f"{max(error):.4f}", f"{psi:.3f}"]
        rows.append([str(views), name, str(len(runs)), shifts, *figures])
    return rows


def section(plan: Plan, results: Results, folder: Path) -> Values:
    """Draw the pair plots at both numbers of views and the close-up, and return the distances between the runs."""
    source = default_source()
    rows: list[list[str]] = []
    for views in (plan.dense_views, plan.sparse_views):
        title = f"L-phantom ({source}), {views} views"
        pair_grid(curve_points(plan, results, views), folder / f"pairs-{views}.png", title)
        rows += _spread(plan, results, views)
    _close_up(plan, results, folder / "pairs-close.png")
    runs = [results[unit.name] for unit in curve_units(plan, plan.dense_views)]
    one = results[_one(plan.dense_views).name]
    curve = np.array([run["frame"] for run in runs])
    shifts = [run["theta"][2] for run in runs]
    column, ratio = curve[:, 3], curve[:, 2] / curve[:, 1]
    return {
        "dense_runs": str(plan.dense_runs),
        "sparse_runs": str(plan.sparse_runs),
        "source": source,
        "dense": str(plan.dense_views),
        "sparse": str(plan.sparse_views),
        "printed_here": shift_range(PHANTOM),
        "printed_hole": shift_range("rectangle-with-hole"),
        "column": f"{column.min():.1f} and {column.max():.1f} mm",
        "true_column": f"{TRUE_FRAME.cor_column_mm:.1f}",
        "magnification": f"{ratio.min():.3f} and {ratio.max():.3f}",
        "true_magnification": f"{TRUE_FRAME.magnification:.3f}",
        "twin_error": f"{one['twin_ray_error_mm']:.1g}",
        "paper_shifts": f"{min(shifts):.0f} to {max(shifts):.0f}",
        "paper_median_mm": f"{np.median([run['ray_error_mm'] for run in runs]):.2f}",
        "default_shift": f"{one['theta'][2]:.0f}",
        "default_error_mm": f"{one['ray_error_mm']:.3f}",
        "table": pictures.table(HEADER, rows),
        "seeds": str(plan.noise_seeds),
        "sparse_size": str(plan.sparse_image_size),
        "dense_size": str(plan.dense_image_size),
        "cells": str(SCANNER.num_detector_pixels // plan.dense_binned),
    }


EXPERIMENT = Experiment("pairs", units, section)
