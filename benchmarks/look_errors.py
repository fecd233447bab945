"""Errors of 3 000 looks at 150 unchanged scanners, from which the study of run lengths draws.

    python benchmarks/look_errors.py [--mills 150] [--looks 20] [--seed 1] [--output FILE]

Each scanner has its own geometry, number of views and rows, noise, and flat field's error, which stays; each log is
another (`mill_logs`). Finished scanners are kept, and the command continues where it ended.
"""

import argparse
import time
from collections import Counter
from pathlib import Path

import numpy as np
from mill_logs import Mill, Nails
from numpy.typing import NDArray
from scanners import SCANNER

from sawmill_tomography.drift.change import DriftError
from sawmill_tomography.drift.detector_fit import detector_fit
from sawmill_vocabulary import Rotation

# Views and rows of a mill's scans of logs.
VIEWS = (12, 16, 20, 30, 45)
ROWS = (60, 250, 1000)
NAILS: tuple[Nails, ...] = ("none", "masked", "left")
NAILS_SHARE = (0.8, 0.15, 0.05)
OUTPUT = Path("benchmarks/output/look-errors.npz")

Table = dict[str, NDArray[np.float64]]


def looks_of_a_mill(number: int, seed: int, looks: int) -> tuple[Table, Counter[str]]:
    """Return errors (looks, 2) in mm and rad with the reported covariances (looks, 2, 2), and refusals by code."""
    rng = np.random.default_rng([seed, number])
    views, rows = VIEWS[number % len(VIEWS)], ROWS[number // len(VIEWS) % len(ROWS)]
    mill = Mill.random(rng, views, rows)
    truth, start = mill.frame(), mill.calibrated(rng)
    errors, covariances, refused = [], [], Counter[str]()
    for _ in range(looks):
        rays = mill.look(rng, nails=NAILS[rng.choice(len(NAILS), p=NAILS_SHARE)])
        try:
            fit = detector_fit(SCANNER, rays, mill.angles_rad, start, Rotation.AS_GIVEN)
        except DriftError as refusal:
            refused[refusal.code] += 1
            continue
        errors.append([fit.cor_column_mm - truth.cor_column_mm, fit.tilt_rad - truth.tilt_rad])
        covariances.append(fit.covariance[:2, :2])
    size = len(errors)
    table = {
        "mill": np.full(size, float(number)),
        "views": np.full(size, float(views)),
        "rows": np.full(size, float(rows)),
        "error": np.array(errors).reshape(size, 2),
        "covariance": np.array(covariances).reshape(size, 2, 2),
    }
    return table, refused


def main() -> None:
    """Add scanners until there are enough of them or time is up."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mills", type=int, default=150)
    parser.add_argument("--looks", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="end after that time")
    parser.add_argument("--output", type=Path, default=OUTPUT)
    options = parser.parse_args()
    tables: list[Table] = []
    if options.output.exists():
        tables.append(dict(np.load(options.output)))
    done = int(tables[0]["mill"].max()) + 1 if tables else 0
    refused, began = Counter[str](), time.monotonic()
    for number in range(done, options.mills):
        table, refusals = looks_of_a_mill(number, options.seed, options.looks)
        tables, refused, done = [*tables, table], refused + refusals, number + 1
        if time.monotonic() - began > options.seconds:
            break
    together = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    options.output.parent.mkdir(parents=True, exist_ok=True)
    np.savez(options.output, **together)
    print(f"{done} of {options.mills} scanners, {len(together['mill'])} looks; refused in this run: {dict(refused)}")


if __name__ == "__main__":
    main()
