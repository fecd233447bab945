"""The paper's Table 1: both phantoms, five runs each, the product's two methods beside what the paper prints."""

from pathlib import Path

import numpy as np
from scans import TRUE_THETA, sources

from paper import pictures
from paper.experiment import Experiment, Plan, Result, Results, Unit, Values
from paper.searches import MadeOf, default_unit, odl_unit, paper_unit

# Relative error and SSIM of the log's FBP, as far as the paper's figures are known here: the best and the worst run.
PRINTED_BEST, PRINTED_WORST = ("0.045", "0.928"), ("0.122", "not available here")
NOT_HERE = "not available here"


def scans() -> list[tuple[str, MadeOf]]:
    """Phantom and data: of the rectangle with a hole there are simulated scans only."""
    published: list[tuple[str, MadeOf]] = [("l-shape", "published")] if "published" in sources() else []
    return [*published, ("l-shape", "simulated"), ("rectangle-with-hole", "simulated")]


def runs(plan: Plan, phantom: str, made_of: MadeOf) -> dict[str, list[Unit]]:
    """The runs of each method on one scan."""
    seeds = range(plan.table_runs)
    found = {
        "default": [default_unit(phantom, made_of, plan.dense_views, seed) for seed in seeds],
        "paper": [paper_unit(plan, phantom, made_of, plan.dense_views, seed) for seed in seeds],
    }
    if plan.in_odl:
        found["ODL"] = [odl_unit(phantom, made_of, plan.dense_views, seed) for seed in seeds]
    return found


def units(plan: Plan) -> list[Unit]:
    """All of them."""
    return [unit for scan in scans() for method in runs(plan, *scan).values() for unit in method]


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
        f"{result['seconds']:.2f}",
    ]


def _truth() -> list[str]:
    alpha0, r_d, h_s, h_d, alpha_d = TRUE_THETA.to_vector()
    return [
        "truth",
        f"{alpha0:.4f}",
        f"{r_d:.2f}",
        f"{h_s:.2f}",
        f"{h_d:.2f}",
        f"{alpha_d:.4f}",
        *["0", "1", "0", "0", ""],
    ]


def _printed(phantom: str) -> list[list[str]]:
    """What the paper prints, where it is known."""
    unknown = [NOT_HERE] * 5
    if phantom != "l-shape":
        return [["the paper, all runs", *unknown, NOT_HERE, NOT_HERE, "", "", NOT_HERE]]
    shift = ["", "", "-223 to 425", "", ""]
    return [
        ["the paper, best run", *unknown, *PRINTED_BEST, "", "", NOT_HERE],
        ["the paper, worst run", *unknown, *PRINTED_WORST, "", "", NOT_HERE],
        ["the paper, all runs", *shift, "", "", "", "", ""],
    ]


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
    "seconds",
)


def section(plan: Plan, results: Results, folder: Path) -> Values:  # noqa: ARG001 - a table alone has no pictures
    """One table for each scan, and what it shows."""
    parts = []
    for number, (phantom, made_of) in enumerate(scans()):
        methods = runs(plan, phantom, made_of)
        first = phantom not in {earlier for earlier, _ in scans()[:number]}
        rows = [_truth(), *(_printed(phantom) if first else ())]
        rows += [_row(m, n, results[unit.name]) for m, made in methods.items() for n, unit in enumerate(made)]
        noise = "" if made_of == "published" else " with 2 % noise, of its own in each run"
        parts.append(f"### {phantom}, {plan.dense_views} views, {made_of}{noise}\n")
        parts.append(pictures.table(HEADER, rows) + "\n")
        parts += [_shows(method, [results[unit.name] for unit in made]) + "\n" for method, made in methods.items()]
    return {"tables": "\n".join(parts).rstrip("\n")}


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


EXPERIMENT = Experiment("table-1", "Table 1", units, section)
