"""The calibration's bounds by family of faults, on scans by exact chords, which should hold in 95 % of each.

    python benchmarks/families.py [--scans 1000] [--seed 1] [--jobs 2] [--family NAME] [--out build/families.jsonl]
        [--write]
    python benchmarks/families.py --table build/families.jsonl

The families (`family_scans.FAMILIES`) are beam and detector, modules, mechanics, wood, and few views. A scan has one to
three effects of its family, counts with ten flats and noise of its own; 12 to 180 views, or 8 to 24. Results are
appended to a file of JSON lines; an interrupted study continues where it stopped. `--write` writes
`benchmarks/results/families-seed-SEED.json`, if all lines are of its seed and of the commit that is checked out.

The columns: scans and refusals; verdicts; wrong passes of the rays (true ray error above 0.1 mm); the share that passes
of scans whose true error is below 0.05 mm; median true ray error and bound (`upper_95`), mm; the share within the
bound, beside the least share that the 99 % interval of a count around 95 % holds, with a star where it is below; median
true error and bound of the scale, %, and its share likewise.
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numba
import numpy as np
from family_scans import FAMILIES, FamilyScan
from measurement import Measurement, check_lines, commit
from rich.progress import track
from scipy.stats import binom

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.refusals import CalibrationError
from sawmill_tomography.geometry.ray_error import ray_error

SCANS = 1000
TOLERANCE_MM, GOOD_MM = 0.1, 0.05
PROMISED, INTERVAL = 0.95, 0.99
HEADER = (
    f"{'':17s} {'scans':>5s} {'none':>4s} {'pass':>5s} {'watch':>5s} {'fail':>5s} {'wrong':>5s} {'of good':>7s} "
    f"{'error':>6s} {'bound':>6s} {'holds (99 % >)':>15s} {'scale':>6s} {'bound':>6s} {'holds (99 % >)':>15s}"
)

PAGE_HEADER = (
    "| family | scans | `upper_95` holds (least: 99 % interval) | passes | wrong passes (above 0.1 mm) |",
    "|---|---|---|---|---|",
)
PAGE_ROW = "| {} | {scans} | {holds_percent:.1f} % ({least_percent:.1f} %) | {passed_percent:.0f} % | {wrong} |"

Line = dict[str, Any]


def outcome(family: str, number: int, seed: int) -> Line:
    """Return the outcome of one scan, as JSON has it."""
    scan = FamilyScan.of(family, number, seed)
    making = scan.making
    about: Line = {
        "family": family,
        "number": number,
        "sizes": {name: round(size, 5) for name, size in scan.sizes.items()},
        "phantom": making.drawing.name,
        "views": making.views,
        "photons": round(making.photons),
        "modules": [(one.first_cell, one.gap_mm, one.kink_rad) for one in making.detector.modules],
    }
    try:
        found = calibrate(scan.task, seed=number)
    except CalibrationError as error:
        return about | {"refused": error.code}
    assert found.findings.error_bars is not None
    true = ray_error(making.scanner, making.frame, found.frame, other_scanner=found.scanner, radius_mm=found.radius_mm)
    return about | {
        "error_mm": true.rms_mm,
        "upper_95_mm": found.findings.error_bars.predicted_ray_error.upper_95_mm,
        "scale_error_percent": 100.0 * true.scale_change,
        "scale_uncertainty_percent": found.findings.scale.percent_95,
        "verdict": found.judgement.verdict,
        "rays_verdict": found.judgement.rays_verdict,
        "adjustments": list(found.adjustments),
        "reasons": list(found.judgement.reasons),
    }


def table(lines: Sequence[Line]) -> str:
    """Format the table by family."""
    rows = [_row(family, [line for line in lines if line["family"] == family]) for family in FAMILIES]
    return "\n".join([HEADER, *filter(None, rows)])


def _row(family: str, lines: Sequence[Line]) -> str:
    answered = [line for line in lines if "refused" not in line]
    if not answered:
        return ""
    errors, scales = (np.array([abs(line[name]) for line in answered]) for name in ("error_mm", "scale_error_percent"))
    bounds, scale_bounds = (
        np.array([line[name] for line in answered]) for name in ("upper_95_mm", "scale_uncertainty_percent")
    )
    verdicts = [np.mean([line["verdict"] == verdict for line in answered]) for verdict in ("pass", "watch", "fail")]
    passed = np.array([line["rays_verdict"] == "pass" for line in answered])
    of_good = passed[errors < GOOD_MM]
    return (
        f"{family:17s} {len(lines):5d} {len(lines) - len(answered):4d} {verdicts[0]:5.0%} {verdicts[1]:5.0%} "
        f"{verdicts[2]:5.0%} {sum(map(_wrong, answered)):5d} "
        f"{np.mean(of_good) if of_good.size else 1.0:7.0%} {np.median(errors):6.3f} {np.median(bounds):6.3f} "
        f"{_holds(errors <= bounds):>15s} {np.median(scales):6.3f} {np.median(scale_bounds):6.3f} "
        f"{_holds(scales <= scale_bounds):>15s}"
    )


def _holds(within: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> str:
    """Format the share within the bound, and the least that the interval around 95 % holds."""
    least = least_share(within.size)
    return f"{within.mean():.1%} ({least:.1%}){'*' if within.mean() < least else ' '}"


def least_share(count: int) -> float:
    """Return the least share that the interval around 95 % holds."""
    return float(binom.interval(INTERVAL, count, PROMISED)[0]) / count


def summary(lines: Sequence[Line]) -> dict[str, Any]:
    """Return the figures of the pages: of each family, and of all."""
    families = {name: [line for line in lines if line["family"] == name] for name in FAMILIES}
    rows = {
        name: _figures(of_family)
        for name, of_family in families.items()
        if any("refused" not in line for line in of_family)
    }
    wrong_mm = sorted(line["error_mm"] for line in lines if _wrong(line))
    return {
        "scans": len(lines),
        "wrong": len(wrong_mm),
        "wrong_mm": _range(wrong_mm, "0.2f") if wrong_mm else "none",
        "holds_percent": _range([row["holds_percent"] for row in rows.values()], "0.0f"),
        "scale_holds_percent": _range([row["scale_holds_percent"] for row in rows.values()], "0.1f"),
        "table": "\n".join([*PAGE_HEADER, *(PAGE_ROW.format(name, **row) for name, row in rows.items())]),
        "families": rows,
    }


def _figures(lines: Sequence[Line]) -> dict[str, float]:
    answered = [line for line in lines if "refused" not in line]
    within = [line["error_mm"] <= line["upper_95_mm"] for line in answered]
    in_scale = [abs(line["scale_error_percent"]) <= line["scale_uncertainty_percent"] for line in answered]
    return {
        "scans": len(lines),
        "holds_percent": 100.0 * float(np.mean(within)),
        "least_percent": 100.0 * least_share(len(answered)),
        "scale_holds_percent": 100.0 * float(np.mean(in_scale)),
        "passed_percent": 100.0 * sum(line["verdict"] == "pass" for line in answered) / len(lines),
        "wrong": sum(_wrong(line) for line in lines),
    }


def _wrong(line: Line) -> bool:
    return line.get("rays_verdict") == "pass" and line["error_mm"] > TOLERANCE_MM


def _range(values: Sequence[float], digits: str) -> str:
    return f"{min(values):{digits}} to {max(values):{digits}}"


def read(path: Path) -> list[Line]:
    """Read the results so far, without a line that was interrupted."""
    return [json.loads(line) for line in path.read_text().split("\n")[:-1]]


def wanted(scans: int, family: str | None, done: set[tuple[str, int]]) -> Iterator[tuple[str, int]]:
    """Yield the scans that are missing, the families in turns."""
    for number in range(scans):
        for name in FAMILIES:
            if family in {None, name} and (name, number) not in done:
                yield name, number


def run(options: argparse.Namespace) -> None:
    """Append what the results file does not have yet."""
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.touch()
    written = options.out.read_bytes()
    options.out.write_bytes(written[: written.rfind(b"\n") + 1])
    done = {(line["family"], line["number"]) for line in read(options.out)}
    with (
        options.out.open("a") as file,
        ProcessPoolExecutor(options.jobs, get_context("spawn"), numba.set_num_threads, (1,)) as pool,
    ):
        left = wanted(options.scans, options.family, done)
        running = [pool.submit(outcome, family, number, options.seed) for family, number in left]
        for one in track(as_completed(running), total=len(running), description="scans"):
            file.write(json.dumps(one.result() | {"commit": commit(), "seed": options.seed}) + "\n")
            file.flush()


def main(arguments: list[str] | None = None) -> None:
    """Run what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scans", type=int, default=SCANS, help="of each family")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--family", choices=tuple(FAMILIES))
    parser.add_argument("--out", type=Path, default=Path("build/families.jsonl"))
    way = parser.add_mutually_exclusive_group()
    way.add_argument("--table", type=Path, metavar="RESULTS", help="only print the table of these results")
    way.add_argument("--write", action="store_true", help="write the figures of the pages")
    options = parser.parse_args(arguments)
    measurement = Measurement.begin("worker/sawmill_tomography/calibration") if options.write else None
    if options.table is None:
        run(options)
    lines = read(options.table or options.out)
    print(table(lines))
    if measurement is not None:
        check_lines(options.out, seed=options.seed)
        measurement.write({f"families-seed-{options.seed}": summary(lines)}, timed=False)


if __name__ == "__main__":
    main()
