"""The tables of benchmarks/log_table.py as Markdown, from the files that it keeps."""

import json
from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from log_methods import METHODS
from log_scans import PUBLISHED

# Kept figures of a method on a scan.
Figures = dict[str, Any]
# Figures of all logs of a number of views and a noise, by the log and by the method.
Logs = dict[str, dict[str, Figures]]
Measure = Callable[[Figures], float | None]
# Methods with and without coupling.
ALONE, COUPLED = ("total variation", "ring-aware"), "{}, coupled"


def tables(folder: Path) -> Iterator[str]:
    """Format the tables of a folder's files, the published log apart; then the change by coupling on each whole log."""
    published, whole = defaultdict[tuple[int, float], Logs](dict), defaultdict[tuple[int, float], Logs](dict)
    for path in sorted(folder.glob("*_*_*.json")):
        log, *setting = path.stem.split("_")
        of_kind = published if log == PUBLISHED else whole
        of_kind[int(setting[0]), float(setting[1])][log] = json.loads(path.read_text())
    yield from pivot("Whole logs, error of the middle row", whole, middle_row, 4)
    yield from pivot("Whole logs, error of all rows", whole, all_rows, 4)
    for name in ("nail", "knot"):
        yield from pivot(f"Whole logs, contrast of the {name}", whole, partial(contrast, name), 2)
    yield from pivot("Whole logs, processor seconds a slice", whole, lambda one: one["cpu_s"], 3)
    yield from pivot("Whole logs, seconds of the clock a slice", whole, lambda one: one["wall_s"], 3)
    yield from pivot("Whole logs, processor seconds of choosing", whole, lambda one: one["choosing_cpu_s"], 1)
    yield from pivot("Published log, error", published, middle_row, 4)
    yield from pivot("Published log, processor seconds a slice", published, lambda one: one["cpu_s"], 3)
    for (views, noise), logs in sorted(whole.items()):
        for name in ALONE:
            yield from coupling(name, f"{views} views, {100.0 * noise:g} % noise", logs)


def middle_row(one: Figures) -> float:
    """Return the error of the middle row, by which all methods are compared."""
    return float(one["error"])


def all_rows(one: Figures) -> float | None:
    """Return the mean error of all rows; None of a method that made the middle row alone."""
    return float(np.mean(one["errors"])) if "errors" in one else None


def contrast(name: str, one: Figures) -> float | None:
    """Return a contrast as a share of the truth's; None where noise hides it, or the middle row alone was made."""
    share = one.get(name)
    return share if share is not None and share > 0.0 else None


def pivot(title: str, settings: dict[tuple[int, float], Logs], measure: Measure, digits: int) -> Iterator[str]:
    """Tabulate methods by settings: geometric means over the logs; their number in brackets, if not the column's."""
    if not settings:
        return
    columns = sorted(settings)
    heads = (f"{views} views, {100.0 * noise:g} % ({len(settings[views, noise])})" for views, noise in columns)
    yield f"{title} (logs):\n\n| method | " + " | ".join(heads) + " |"
    yield "|---|" + "---|" * len(columns)
    for name in METHODS:
        cells = [mean(name, settings[column], measure, digits) for column in columns]
        if any(cells):
            yield f"| {name} | " + " | ".join(cells) + " |"
    yield ""


def mean(name: str, logs: Logs, measure: Measure, digits: int) -> str:
    """Format a mean; empty where no log has the figure."""
    found = [value for kept in logs.values() if name in kept and (value := measure(kept[name]))]
    if not found:
        return ""
    return f"{geometric_mean(found):.{digits}f}" + (f" ({len(found)})" if len(found) < len(logs) else "")


def geometric_mean(values: list[float]) -> float:
    """Compute the geometric mean of positive numbers."""
    return float(np.exp(np.mean(np.log(values))))


def coupling(name: str, title: str, logs: Logs) -> Iterator[str]:
    """Tabulate a method's coupled figure as a share of the uncoupled one: over the logs, then log by log."""
    coupled = COUPLED.format(name)
    both = [(kept[name], kept[coupled]) for kept in logs.values() if {name, coupled} <= kept.keys()]
    if not both:
        return
    yield f"Coupled {name} as a share of uncoupled, {title}:\n"
    yield "| | mean | least | largest | each log |\n|---|---|---|---|---|"
    measures: dict[str, Measure] = {
        "error of all rows": all_rows,
        "error without two rows at either end": lambda one: float(np.mean(one["errors"][2:-2])),
        "contrast of the nail": partial(contrast, "nail"),
        "contrast of the knot": partial(contrast, "knot"),
        "processor seconds": lambda one: one["cpu_s"],
    }
    for figure, measure in measures.items():
        pairs = [(measure(after), measure(before)) for before, after in both]
        shares = [after / before for after, before in pairs if after and before]
        if shares:
            each = " ".join(f"{share:.3f}" for share in shares)
            yield f"| {figure} | {geometric_mean(shares):.3f} | {min(shares):.3f} | {max(shares):.3f} | {each} |"
    yield ""
