"""Reconstruction methods x views: each method on a log from many views and from few, with the true geometry."""

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from edge_error import edge_error_mm
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, LogLocator, NullFormatter, NullLocator, StrMethodFormatter
from scanners import SCANNER
from scans import ANGLES, GRID, TRUE_THETA, Source, log_sinogram, log_truth, sources

from paper import pictures
from paper.experiment import Experiment, Plan, Result, Results, Unit, Values
from paper.searches import every_so_many
from sawmill_tomography.geometry.geometry import FanBeamGeometry, FloatArray
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.cauchy_map import cauchy_map
from sawmill_tomography.reconstruction.estimate import Estimate
from sawmill_tomography.reconstruction.fbp import fbp
from sawmill_tomography.reconstruction.quality import relative_error, structural_similarity_index
from sawmill_tomography.reconstruction.tikhonov import tikhonov
from sawmill_tomography.reconstruction.total_variation import total_variation
from sawmill_tomography.sinograms.noise import data_misfit, noise_of_each_ray

# The published settings of `cauchy_map` are in the unit of the published log, whose wood is about this.
PUBLISHED_WOOD = 0.4
# Edge errors that differ by less than this factor do not say which image is the better one.
MARKED = 1.2


@dataclass(frozen=True)
class Method:
    """A reconstruction method, the style of its curve, and about how many seconds a view costs on an idle core."""

    reconstruct: Callable[[Projector, FloatArray], Estimate]
    colour: str
    line: str
    seconds_a_view: float


METHODS: Mapping[str, Method] = {
    "fbp": Method(fbp, pictures.BLACK, "-", 0.0),
    "tikhonov": Method(tikhonov, pictures.SKY, "--", 0.02),
    "cauchy_map": Method(cauchy_map, pictures.ORANGE, "-", 0.06),
    "cauchy_map paper": Method(partial(cauchy_map, preset="paper"), pictures.PURPLE, ":", 0.05),
    "total_variation": Method(total_variation, pictures.BLUE, "-.", 0.07),
}


@dataclass(frozen=True)
class Measure:
    """A measure of an image's quality: its key in a result, and its words."""

    key: str
    words: str
    highest_is_best: bool = False


RELATIVE = Measure("relative_error", "relative error")
SSIM = Measure("ssim", "SSIM", highest_is_best=True)
EDGES = Measure("edge_error_mm", "edge error, mm")


def scale_of(source: Source) -> float:
    """Return the factor that brings a log to the unit of the published one."""
    return 1.0 if source == "published" else PUBLISHED_WOOD / SAPWOOD_PER_MM


def truth(source: Source, size: int) -> FloatArray:
    """Return the log itself on (size, size) pixels [x, y], in the unit of the published one."""
    by = GRID.size // size
    image: FloatArray = log_truth(source).reshape(size, by, size, by).mean(axis=(1, 3)) * scale_of(source)
    return image


def run(source: Source, method: str, views: int, size: int) -> Result:
    """Reconstruct one image and return its figures."""
    take = every_so_many(views)
    lines = log_sinogram(source)[take] * scale_of(source)
    geometry = FanBeamGeometry(SCANNER, TRUE_THETA, ANGLES[take])
    projector = Projector(geometry, ImageGrid(size, GRID.field_mm))
    image = METHODS[method].reconstruct(projector, lines).image
    log, block = truth(source, size), projector.block(lines)
    return {
        "relative_error": relative_error(image, log),
        "ssim": structural_similarity_index(image, log),
        "edge_error_mm": edge_error_mm(image, log, projector.grid.pixel_mm),
        "misfit": float(data_misfit(projector, image[None], block, noise_of_each_ray(None, block))[0]),
        "image": image,
    }


def unit(plan: Plan, source: Source, method: str, views: int) -> Unit:
    """Return the unit of one image."""
    settings = {"source": source, "method": method, "views": views, "size": plan.log_image_size}
    seconds = 0.5 + METHODS[method].seconds_a_view * views
    return Unit(f"methods-{source}-{method.replace(' ', '-')}-{views}", run, settings, seconds)


def units(plan: Plan) -> list[Unit]:
    """List the units of every log with every method at every number of views."""
    return [
        unit(plan, source, method, views) for source in sources() for method in METHODS for views in plan.compared_views
    ]


Images = Mapping[tuple[str, int], Result]


def images_of(plan: Plan, results: Results, source: Source) -> Images:
    """Select one log's results by method and views."""
    return {
        (method, views): results[unit(plan, source, method, views).name]
        for method in METHODS
        for views in plan.compared_views
    }


def own_edge_error_mm(source: Source, size: int) -> float:
    """Compute the log's own edge error: outlines nearer to each other than the measure reaches can be mistaken."""
    log = truth(source, size)
    return edge_error_mm(log, log, GRID.field_mm / size)


def _window(log: FloatArray) -> tuple[float, float]:
    """Return the grey window: air is black, and a fragment of metal does not darken the wood."""
    return 0.0, float(np.percentile(log[log > 0.0], 99.0))


def _draw_images(plan: Plan, source: Source, made: Images, path: Path) -> None:
    """Draw methods down, views across, in one grey window."""
    drawn = pictures.figure(7.4, 7.6)
    panels = drawn.subplots(len(METHODS), len(plan.compared_views), squeeze=False)
    low, high = _window(truth(source, plan.log_image_size))
    for row, method in zip(panels, METHODS, strict=True):
        for axes, views in zip(row, plan.compared_views, strict=True):
            axes.imshow(made[method, views]["image"], cmap="gray", vmin=low, vmax=high)
            axes.set_xticks([])
            axes.set_yticks([])
        row[0].set_ylabel(method, fontsize=9)
    for axes, views in zip(panels[0], plan.compared_views, strict=True):
        axes.set_title(f"{views} views", fontsize=9)
    pictures.save_greys(drawn, path)


def _draw_curve(axes: Axes, plan: Plan, made: Images, measure: Measure) -> None:
    for name, method in METHODS.items():
        values = [made[name, views][measure.key] for views in plan.compared_views]
        axes.plot(plan.compared_views, values, method.line, color=method.colour, marker="o", ms=3.5, lw=1.6, label=name)
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(FixedLocator(plan.compared_views))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:.0f}"))
    if not measure.highest_is_best:
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0)))
        axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    axes.tick_params(labelsize=7)
    axes.grid(visible=True, which="both", alpha=0.25, lw=0.5)
    axes.set_xlabel("views", fontsize=8)
    axes.set_ylabel(measure.words, fontsize=8)


def _draw_curves(plan: Plan, results: Results, path: Path) -> None:
    """Draw for each log the log itself, and each measure against the views."""
    drawn = pictures.figure(10.4, 2.7 * len(sources()) + 0.4)
    panels = drawn.subplots(len(sources()), 4, squeeze=False)
    for row, source in zip(panels, sources(), strict=True):
        log, made = truth(source, plan.log_image_size), images_of(plan, results, source)
        pictures.show_image(row[0], log.astype(np.float32), GRID.field_mm, _window(log), f"the {source} log")
        for axes, measure in zip(row[1:], (RELATIVE, SSIM, EDGES), strict=True):
            _draw_curve(axes, plan, made, measure)
        row[3].axhline(own_edge_error_mm(source, plan.log_image_size), color=pictures.BLACK, lw=0.7)
    drawn.legend(*panels[0, 1].get_legend_handles_labels(), loc="outside lower center", ncols=len(METHODS), fontsize=8)
    pictures.save(drawn, path)


HEADER = ("method", "views", "relative error", "SSIM", "edge error, mm", "data misfit")


def _table(made: Images, own_error: float) -> str:
    rows = [["the log itself", "", "0", "1", f"{own_error:.2f}", ""]]
    for (method, views), found in made.items():
        errors = [f"{found['relative_error']:.4f}", f"{found['ssim']:.3f}", f"{found['edge_error_mm']:.2f}"]
        rows.append([f"`{method}`", str(views), *errors, f"{found['misfit']:.2f}"])
    return pictures.table(HEADER, rows)


def least_errors(made: Images, views: tuple[int, ...]) -> str:
    """State which method has the least relative error, and at which numbers of views."""
    where: dict[str, list[str]] = {}
    for count in views:
        _, best = min((made[method, count][RELATIVE.key], method) for method in METHODS)
        where.setdefault(best, []).append(str(count))
    return "; ".join(f"`{method}` from {', '.join(counts)} views" for method, counts in where.items())


def errors_at(made: Images, views: int) -> str:
    """List the relative errors of all methods at one number of views."""
    return ", ".join(f"`{method}` {made[method, views][RELATIVE.key]:.3f}" for method in METHODS)


def contradictions(made: Images, measure: Measure) -> tuple[list[tuple[Result, Result]], int]:
    """List the pairs of images with very different outlines of which a measure prefers the worse; count all such pairs.

    Each pair has the image with the worse outlines first; the pair whose outlines differ most comes first.
    """
    sign = -1.0 if measure.highest_is_best else 1.0
    named = [found | {"name": f"`{method}` from {views} views"} for (method, views), found in made.items()]
    ordered = [sorted(pair, key=lambda one: -one["edge_error_mm"]) for pair in itertools.combinations(named, 2)]
    marked = [(worse, better) for worse, better in ordered if worse["edge_error_mm"] > MARKED * better["edge_error_mm"]]
    wrong = [pair for pair in marked if sign * pair[0][measure.key] < sign * pair[1][measure.key]]
    return sorted(wrong, key=lambda pair: pair[1]["edge_error_mm"] / pair[0]["edge_error_mm"]), len(marked)


def _shows(plan: Plan, made: Images) -> str:
    """State what a log's table shows, in words."""
    by_ssim, marked = contradictions(made, SSIM)
    by_error, _ = contradictions(made, RELATIVE)
    text = (
        f"Least relative error: {least_errors(made, plan.compared_views)}. Of {marked} pairs "
        f"of images whose edge errors differ by a factor of {MARKED:g} or more, SSIM prefers the one with the worse "
        f"outlines in {len(by_ssim)}, the relative error in {len(by_error)}."
    )
    if not by_ssim:
        return text
    worse, better = by_ssim[0]
    return (
        f"{text} The largest difference: SSIM rates {worse['name']} ({worse['ssim']:.3f}) above {better['name']} "
        f"({better['ssim']:.3f}), and its outlines are off by {worse['edge_error_mm']:.2f} mm instead of "
        f"{better['edge_error_mm']:.2f}."
    )


def section(plan: Plan, results: Results, folder: Path) -> Values:
    """Draw the images of the first log, the curves and tables of all."""
    parts = []
    for source in sources():
        made = images_of(plan, results, source)
        own = own_edge_error_mm(source, plan.log_image_size)
        parts.append(f"### The {source} log\n\n{_shows(plan, made)}\n\n{_table(made, own)}")
    first = sources()[0]
    _draw_images(plan, first, images_of(plan, results, first), folder / "methods.png")
    _draw_curves(plan, results, folder / "methods-curves.png")
    return {
        "source": first,
        "size": str(plan.log_image_size),
        "field": f"{GRID.field_mm:g}",
        "wood": f"{PUBLISHED_WOOD:g}",
        "sparse_errors": errors_at(images_of(plan, results, first), min(plan.compared_views)),
        "logs": "\n\n".join(parts),
    }


EXPERIMENT = Experiment("methods", units, section)
