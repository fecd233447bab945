"""The table of benchmarks/log_table.py as text, from the files that it keeps."""

import json
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from log_methods import METHODS
from log_scans import PUBLISHED

# Of a method on a scan, as they are kept.
Figures = dict[str, Any]
# Of all logs of a setting, by the log.
Logs = dict[str, dict[str, Figures]]
ALONE, COUPLED = "total variation", "total variation, coupled"


def table(folder: Path) -> Iterator[str]:
    """All files of a folder, the published log apart; then what coupling changes on each whole log."""
    settings = defaultdict[tuple[bool, int, float], Logs](dict)
    for path in sorted(folder.glob("*_*_*.json")):
        log, *setting = path.stem.split("_")
        settings[log != PUBLISHED, int(setting[0]), float(setting[1])][log] = json.loads(path.read_text())
    yield f"{'':30s}{'error':>8s}{'all':>8s}{'nail':>7s}{'knot':>7s}{'cpu s':>9s}{'wall s':>9s}{'choosing':>9s}  (logs)"
    for (whole, views, noise), logs in sorted(settings.items()):
        yield f"{'whole logs' if whole else 'published log'}, {views} views, {100.0 * noise:g} % noise"
        for name in METHODS:
            found = [kept[name] for kept in logs.values() if name in kept]
            if found:
                yield f"  {name:28s}{line(found)}  ({len(found)})"
        yield from coupling(logs) if whole else ()


def line(found: list[Figures]) -> str:
    """Errors, contrasts and seconds of one method over some logs."""
    every = [float(np.mean(one["errors"])) for one in found if "errors" in one]
    cells = [cell([one["error"] for one in found], geometric_mean, 8, 4), cell(every, geometric_mean, 8, 4)]
    columns = (("nail", 7, 2), ("knot", 7, 2), ("cpu_s", 9, 4), ("wall_s", 9, 4), ("choosing_cpu_s", 9, 2))
    for name, width, digits in columns:
        cells += [cell([one[name] for one in found if one.get(name) is not None], np.mean, width, digits)]
    return "".join(cells)


def cell(values: list[float], mean: Callable[[list[float]], Any], width: int, digits: int) -> str:
    """Empty where no log has it."""
    return f"{mean(values):{width}.{digits}f}" if values else " " * width


def geometric_mean(values: list[float]) -> float:
    """Of errors."""
    return float(np.exp(np.mean(np.log(values))))


def coupling(logs: Logs) -> Iterator[str]:
    """The coupled figure as a share of the uncoupled one: over the logs, then log by log."""
    both = {log: (kept[ALONE], kept[COUPLED]) for log, kept in logs.items() if {ALONE, COUPLED} <= kept.keys()}
    if not both:
        return
    yield "  coupled as a share of uncoupled: mean over the logs, least and largest, each log"
    measures: dict[str, Callable[[Figures], float | None]] = {
        "error of all rows": lambda one: float(np.mean(one["errors"])),
        "error, two rows at either end left out": lambda one: float(np.mean(one["errors"][2:-2])),
        "contrast of the nail": lambda one: one["nail"],
        "contrast of the knot": lambda one: one["knot"],
        "processor seconds": lambda one: one["cpu_s"],
    }
    for name, measure in measures.items():
        pairs = [(measure(coupled), measure(alone)) for alone, coupled in both.values()]
        shares = [after / before for after, before in pairs if after and before]
        if shares:
            each = " ".join(f"{share:.3f}" for share in shares)
            yield f"    {name:40s}{geometric_mean(shares):.3f}  {min(shares):.3f} to {max(shares):.3f}:  {each}"
