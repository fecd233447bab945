"""The objective on FBP images against one on sinograms: their profiles through the truth, and searches with both."""

from collections.abc import Mapping
from pathlib import Path
from typing import Literal, cast

import numpy as np
from scanners import SCANNER
from scans import ANGLES, TRUE_FRAME

from paper import pictures
from paper.experiment import Experiment, Plan, Result, Results, Unit, Values
from paper.pairs import FRAME_LABELS, TO_DEGREES
from paper.searches import MadeOf, binned, default_source, every_so_many, phantom_scan, scores
from sawmill_tomography.calibration.paper import PaperObjective, PaperSettings, calibrate_as_published
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import FloatArray, SourceFrame, to_vector
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_vocabulary import Rotation

# Farthest from the truth that each profile goes: psi, R, SDD, u_c, tau.
REACH = np.array([np.radians(1.0), 40.0, 60.0, 4.0, np.radians(3.0)])
# How much worse than its best an objective is where its width is measured.
LEVEL = 1e-3
PUBLISHED, ON_SINOGRAMS = "FBP image, as published", "sinogram, normalised"
SECOND = "sinogram, the paper's second"
OBJECTIVES: Mapping[str, PaperSettings] = {
    PUBLISHED: PaperSettings(),
    "FBP image, exact weights, normalised": PaperSettings(weighting="exact", correlation="normalised"),
    SECOND: PaperSettings(objective="projection"),
    ON_SINOGRAMS: PaperSettings(objective="projection", correlation="normalised"),
}
STYLES = ((pictures.ORANGE, "-"), (pictures.GREEN, "--"), (pictures.PURPLE, ":"), (pictures.BLUE, "-."))


def run_profile(objective: str, views: int, points: int) -> Result:
    """Compute an objective through the truth along each parameter of the source frame, on exact data: (5, points)."""
    take = every_so_many(views)
    task = CalibrationTask(SCANNER, L_SHAPE, phantom_scan("l-shape", "exact", 0)[take], ANGLES[take])
    measure = PaperObjective(task, Rotation.AS_GIVEN, OBJECTIVES[objective])
    values = np.empty((len(REACH), points))
    for parameter, reach in enumerate(REACH):
        for number, offset in enumerate(np.linspace(-reach, reach, points)):
            vector = to_vector(TRUE_FRAME)
            vector[parameter] += offset
            theta = SourceFrame.from_vector(vector).theta(SCANNER.source_to_cor_mm)
            values[parameter, number] = measure(to_vector(theta))
    return {"values": values}


def run_search(
    objective: str,
    stop: str,
    views: int,
    seed: int,
    image_size: int,
    max_generations: int,
    made_of: MadeOf,
    cells_binned: int = 1,
) -> Result:
    """Run differential evolution with one of the objectives and one of the stops."""
    take = every_so_many(views)
    chosen = OBJECTIVES[objective]
    options = PaperSettings(
        objective=chosen.objective,
        weighting=chosen.weighting,
        correlation=chosen.correlation,
        stop=cast('Literal["published", "tight"]', stop),
        max_generations=max_generations,
        image_size=image_size,
    )
    scanner, sinogram = binned(SCANNER, phantom_scan("l-shape", made_of, 0)[take], cells_binned)
    task = CalibrationTask(scanner, L_SHAPE, sinogram, ANGLES[take])
    found = calibrate_as_published(task, options=options, seed=seed)
    return scores(found.theta, found.frame, found.rotation) | {"evaluations": found.search.evaluations}


def profile_unit(plan: Plan, objective: str, views: int) -> Unit:
    """Return the unit of the profiles of one objective."""
    settings = {"objective": objective, "views": views, "points": plan.profile_points}
    number = list(OBJECTIVES).index(objective)
    return Unit(f"profile-{number}-{views}", run_profile, settings, 20.0 if views > plan.sparse_views else 2.0)


def search_units(plan: Plan, objective: str, stop: str) -> list[Unit]:
    """List the runs with one objective and one stop."""
    number, source = list(OBJECTIVES).index(objective), default_source()
    settings = {"objective": objective, "stop": stop, "views": plan.sparse_views, "made_of": source}
    settings |= {"image_size": plan.study_image_size}
    if OBJECTIVES[objective].objective == "projection":
        settings |= {"cells_binned": plan.study_binned}
    settings |= {"max_generations": plan.tight_generations if stop == "tight" else plan.max_generations}
    return [
        Unit(
            f"objective-{number}-{stop}-{seed}",
            run_search,
            settings | {"seed": seed},
            8.0 if stop == "tight" else 3.0,
        )
        for seed in range(plan.objective_runs)
    ]


def units(plan: Plan) -> list[Unit]:
    """List the units: profiles from many and from few views, and the searches."""
    profiles = [profile_unit(plan, name, v) for name in OBJECTIVES for v in (plan.dense_views, plan.sparse_views)]
    searches = [u for name in OBJECTIVES for stop in ("published", "tight") for u in search_units(plan, name, stop)]
    return [*profiles, *searches]


def optimum(offsets: FloatArray, values: FloatArray) -> float:
    """Locate a profile's minimum, by the parabola through its lowest point and that point's neighbours."""
    at = int(np.clip(np.argmin(values), 1, len(values) - 2))
    left, middle, right = values[at - 1 : at + 2]
    curvature = left - 2.0 * middle + right
    step = float(offsets[1] - offsets[0])
    shift = 0.5 * (left - right) / curvature if curvature > 0.0 else 0.0
    return float(offsets[at] + step * np.clip(shift, -1.0, 1.0))


def half_width(offsets: FloatArray, values: FloatArray, level: float = LEVEL) -> float:
    """Compute the mean distance on both sides at which a profile is worse than its best by a share; NaN if never."""
    worse = (values - values.min()) / abs(values.min()) - level
    at = int(np.argmin(values))
    left, right = np.flatnonzero(worse[:at] > 0.0), at + np.flatnonzero(worse[at:] > 0.0)
    if left.size == 0 or right.size == 0:
        return float("nan")
    crossings = []
    for inner, outer in ((left[-1] + 1, left[-1]), (right[0] - 1, right[0])):
        share = -worse[inner] / (worse[outer] - worse[inner])
        crossings.append(offsets[inner] + share * (offsets[outer] - offsets[inner]))
    return 0.5 * float(crossings[1] - crossings[0])


def _draw(plan: Plan, results: Results, path: Path) -> None:
    drawn = pictures.figure(10.0, 5.0)
    grid = drawn.subplots(2, 5)
    for row, views in zip(grid, (plan.dense_views, plan.sparse_views), strict=True):
        for parameter, axes in enumerate(row):
            offsets = np.linspace(-REACH[parameter], REACH[parameter], plan.profile_points) * TO_DEGREES[parameter]
            for name, (colour, line) in zip(OBJECTIVES, STYLES, strict=True):
                values = results[profile_unit(plan, name, views).name]["values"][parameter]
                deficit = 1e3 * (values - values.min()) / abs(values.min())
                axes.plot(offsets, deficit, line, color=colour, lw=1.4, label=name)
            axes.axvline(0.0, color=pictures.BLACK, lw=0.7)
            axes.set_xlabel("error of " + FRAME_LABELS[parameter], fontsize=8)
            axes.tick_params(labelsize=7)
        row[0].set_ylabel(f"{views} views:\nworse than the best, 1/1000", fontsize=8)
    handles, names = grid[0, 0].get_legend_handles_labels()
    drawn.legend(handles, names, loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    pictures.save(drawn, path)


def _profile_rows(plan: Plan, results: Results) -> list[list[str]]:
    rows = []
    for views in (plan.dense_views, plan.sparse_views):
        for name in OBJECTIVES:
            cells = []
            for parameter, reach in enumerate(REACH):
                offsets = np.linspace(-reach, reach, plan.profile_points) * TO_DEGREES[parameter]
                values = results[profile_unit(plan, name, views).name]["values"][parameter]
                width = half_width(offsets, values)
                shown = f"{width:.3g}" if np.isfinite(width) else f"> {offsets[-1]:.3g}"
                best = optimum(offsets, values)
                edge = " (edge)" if abs(best) >= 0.98 * offsets[-1] else ""
                cells.append(f"{best:+.3g}{edge}; {shown}")
            rows.append([str(views), name, *cells])
    return rows


SEARCH_HEADER = (
    "objective",
    "stop",
    "runs",
    "median ray error, mm",
    "least",
    "largest",
    "R less truth, mm",
    "evaluations",
)


def _search_rows(plan: Plan, results: Results) -> list[list[str]]:
    rows = []
    for name in OBJECTIVES:
        for stop in ("published", "tight"):
            runs = [results[unit.name] for unit in search_units(plan, name, stop)]
            error = [run["ray_error_mm"] for run in runs]
            distance = [run["frame"][1] - TRUE_FRAME.source_distance_mm for run in runs]
            evaluations = np.median([run["evaluations"] for run in runs])
            errors = [f"{np.median(error):.3f}", f"{min(error):.3f}", f"{max(error):.3f}"]
            distances = f"{min(distance):+.1f} to {max(distance):+.1f}"
            rows.append([name, stop, str(len(runs)), *errors, distances, f"{evaluations:.0f}"])
    return rows


def section(plan: Plan, results: Results, folder: Path) -> Values:
    """Return the profiles' figures: places and widths of the optima, and the ends of searches with each objective."""
    _draw(plan, results, folder / "objectives.png")
    turns = np.degrees(np.linspace(-REACH[0], REACH[0], plan.profile_points))
    bias = {
        name: optimum(turns, results[profile_unit(plan, name, plan.sparse_views).name]["values"][0])
        for name in OBJECTIVES
    }
    medians = {
        name: float(np.median([results[unit.name]["ray_error_mm"] for unit in search_units(plan, name, "tight")]))
        for name in OBJECTIVES
    }
    best = min(medians, key=lambda name: medians[name])
    return {
        "sparse": str(plan.sparse_views),
        "source": default_source(),
        "image_bias": f"{bias[PUBLISHED]:+.2f}",
        "sinogram_bias": f"{bias[ON_SINOGRAMS]:+.4f}",
        "level": f"{LEVEL:.1%}",
        "profiles": pictures.table(("views", "objective", *FRAME_LABELS), _profile_rows(plan, results)),
        "runs": str(plan.objective_runs),
        "size": str(plan.study_image_size),
        "binned": str(plan.study_binned),
        "generations": str(plan.tight_generations),
        "best": best,
        "best_error": f"{medians[best]:.3f}",
        "image_error": f"{medians[PUBLISHED]:.3f}",
        "second_error": f"{medians[SECOND]:.0f}",
        "searches": pictures.table(SEARCH_HEADER, _search_rows(plan, results)),
    }


EXPERIMENT = Experiment("objectives", units, section)
