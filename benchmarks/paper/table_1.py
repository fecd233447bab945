"""The paper's Table 1: both phantoms, five runs each, the paper's printed results next to the product's two methods."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scans import GRID, TRUE_THETA, log_image, sources

from paper import pictures
from paper.experiment import Experiment, Plan, Result, Results, Unit, Values
from paper.printed import TABLE_1, PrintedRun, judge
from paper.searches import MadeOf, default_unit, odl_unit, paper_unit
from sawmill_tomography.geometry.geometry import Theta, to_vector

# Rays that are off by more are of no run whose log came out with a relative error of a tenth.
MOST_CREDIBLE_MM = 5.0


def scans() -> list[tuple[str, MadeOf]]:
    """List phantoms and data: of the rectangle with a hole there are simulated scans only."""
    published: list[tuple[str, MadeOf]] = [("l-shape", "published")] if "published" in sources() else []
    return [*published, ("l-shape", "simulated"), ("rectangle-with-hole", "simulated")]


def runs(plan: Plan, phantom: str, made_of: MadeOf) -> dict[str, list[Unit]]:
    """List the runs of each method on one scan."""
    seeds = range(plan.table_runs)
    found = {
        "default": [default_unit(phantom, made_of, plan.dense_views, seed) for seed in seeds],
        "paper": [paper_unit(plan, phantom, made_of, plan.dense_views, seed) for seed in seeds],
    }
    if plan.in_odl:
        found["ODL"] = [odl_unit(phantom, made_of, plan.dense_views, seed) for seed in seeds]
    return found


def printed_unit(phantom: str, number: int) -> Unit:
    """Return the unit that judges one of the paper's runs by its printed theta."""
    return Unit(f"printed-{phantom}-{number}", judge, {"theta": TABLE_1[phantom][number].vector.tolist()}, 0.5)


def units(plan: Plan) -> list[Unit]:
    """List all units."""
    printed = [printed_unit(phantom, number) for phantom, rows in TABLE_1.items() for number in range(len(rows))]
    return [*printed, *(unit for scan in scans() for method in runs(plan, *scan).values() for unit in method)]


def _row(method: str, number: int, result: Result) -> list[str]:
    alpha0, r_d, h_s, h_d, alpha_d = result["theta"]
    log = result[sources()[0]]
    return [
        f"`{method}` {number + 1}",
        f"{alpha0:.4f}",
        f"{r_d:.2f}",
        f"{h_s:.2f}",
        f"{h_d:.2f}",
        f"{alpha_d:.4f}",
        f"{log['relative_error']:.4f}",
        f"{log['ssim']:.4f}",
        f"{result['ray_error_mm']:.4f}",
        f"{result['psi_error_deg']:+.3f}",
    ]


def _truth() -> list[str]:
    alpha0, r_d, h_s, h_d, alpha_d = to_vector(TRUE_THETA)
    return [
        "truth",
        f"{alpha0:.4f}",
        f"{r_d:.2f}",
        f"{h_s:.2f}",
        f"{h_d:.2f}",
        f"{alpha_d:.4f}",
        *["0", "1", "0", "0"],
    ]


def _printed_row(number: int, run: PrintedRun, found: Result) -> list[str]:
    """Format a printed run as it is printed; ray error and psi error with their ranges by the rounding."""
    (least, most), (from_deg, to_deg) = found["ray_error_range_mm"], found["psi_error_range_deg"]
    rays = f"*{found['ray_error_mm']:.2f} ({least:.2f} to {most:.2f})*"
    psi = f"*{found['psi_error_deg']:+.2f} ({from_deg:+.2f} to {to_deg:+.2f})*"
    return [f"the paper, run {number}", *run.theta, run.relative_error, run.ssim, rays, psi]


def _printed(phantom: str, results: Results) -> tuple[list[list[str]], str]:
    """Format the rows that the paper prints for a phantom, and a sentence about them."""
    found = [results[printed_unit(phantom, number).name] for number in range(len(TABLE_1[phantom]))]
    made = list(enumerate(zip(TABLE_1[phantom], found, strict=True), 1))
    rows = [_printed_row(number, run, judged) for number, (run, judged) in made]
    errors, ssim = (sorted(column, key=float) for column in zip(*(row[6:8] for row in rows), strict=True))
    shows = f"The paper: the log's relative error is {errors[0]} to {errors[-1]}, its SSIM {ssim[0]} to {ssim[-1]}."
    for number, (run, judged) in made:
        if judged["ray_error_range_mm"][0] > MOST_CREDIBLE_MM:
            shows += (
                f" The theta of run {number} cannot be that of the run: its rays are off by "
                f"{judged['ray_error_mm']:.0f} mm, and the log's FBP with it has a relative error of "
                f"{judged['relative_error']:.2f} where {run.relative_error} is printed. At least one of its five "
                "numbers is misprinted in the paper."
            )
    return rows, shows


HEADER = (
    "run",
    "alpha0, rad",
    "r_D, mm",
    "h_S, mm",
    "h_D, mm",
    "alpha_D",
    "log's relative error",
    "log's SSIM",
    "ray error, mm",
    "psi error, deg",
)


def draw_gallery(thetas: Sequence[Sequence[float]], path: Path) -> None:
    """Draw the log's FBP with the true theta, and with each theta of a method's runs."""
    given = [("true theta", TRUE_THETA)]
    given += [(f"paper, run {number}", Theta.from_vector(np.array(theta))) for number, theta in enumerate(thetas, 1)]
    images = [(words, log_image(sources()[0], theta)) for words, theta in given]
    limits = (float(np.percentile(images[0][1], 5.0)), float(np.percentile(images[0][1], 99.8)))
    drawn = pictures.figure(8.4, 5.8)
    for axes, (words, image) in zip(drawn.subplots(2, 3).ravel(), images, strict=False):
        pictures.show_image(axes, image, GRID.field_mm, limits, words)
    pictures.save_greys(drawn, path)


def section(plan: Plan, results: Results, folder: Path) -> Values:
    """Draw the log with the thetas of the first scan; format one table for each scan, and sentences about it."""
    of_the_first = runs(plan, *scans()[0])["paper"]
    draw_gallery([results[unit.name]["theta"] for unit in of_the_first], folder / "table-1.png")
    parts = []
    for number, (phantom, made_of) in enumerate(scans()):
        methods = runs(plan, phantom, made_of)
        first = phantom not in {earlier for earlier, _ in scans()[:number]}
        printed, shows = _printed(phantom, results) if first else ([], "")
        rows = [_truth(), *printed]
        rows += [_row(m, n, results[unit.name]) for m, made in methods.items() for n, unit in enumerate(made)]
        noise = "" if made_of == "published" else " with 2 % noise, other noise in each run"
        parts.append(f"### {phantom}, {plan.dense_views} views, {made_of}{noise}\n")
        parts.append(pictures.table(HEADER, rows) + "\n")
        parts += [f"{shows}\n"] if shows else []
        parts += [_shows(method, [results[unit.name] for unit in made]) + "\n" for method, made in methods.items()]
    return {"source": sources()[0], "tables": "\n".join(parts).rstrip("\n")}


def _shows(method: str, made: list[Result]) -> str:
    log = [result[sources()[0]] for result in made]
    errors, ssim = [one["relative_error"] for one in log], [one["ssim"] for one in log]
    rays, shifts = [result["ray_error_mm"] for result in made], [result["theta"][2] for result in made]
    turned = sum(abs(result["psi_error_deg"]) > 90.0 for result in made)
    return (
        f"`{method}`: the log's relative error is {min(errors):.4f} to {max(errors):.4f}, its SSIM {min(ssim):.4f} to "
        f"{max(ssim):.4f}; the median ray error is {np.median(rays):.3f} mm, h_S {min(shifts):.1f} to "
        f"{max(shifts):.1f} mm; {turned} of {len(made)} ended about half a turn away."
    )


EXPERIMENT = Experiment("table-1", units, section)
