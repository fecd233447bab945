"""Gain and cost of coupling along the axis: simulated logs that change along it (`whole_logs.py`), the truth known.

For each log: the coupling that is chosen, the coupled error as a share of the uncoupled one, the coupled contrast of
the nail of 8 mm and of the knot of 12 mm along the axis as a share of the uncoupled one, and the ratio of processor
seconds for the same slices, in one block and without neighbours. Seeds from 4000 are for tuning, seeds from 4100 for
tables.

    python benchmarks/coupling.py [--seed 4000] [--logs 3] [--noise 0.02] [--rows 32] [--size 256]
"""

import argparse
import time

import numpy as np
from log_scans import whole_scan
from scans import GRID
from whole_logs import TUNING_SEED, WholeLog

from sawmill_calibration.reconstruction.reconstruct import SLICES_AROUND
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.reconstruction.total_variation import total_variation
from sawmill_tomography.reconstruction.total_variation_weights import choose_coupling, choose_weight

VIEWS = 20


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=TUNING_SEED)
    parser.add_argument("--logs", type=int, default=3)
    parser.add_argument("--noise", type=float, default=0.02)
    parser.add_argument("--rows", type=int, default=32)
    parser.add_argument("--size", type=int, default=256)
    asked = parser.parse_args()
    grid = ImageGrid(asked.size, GRID.field_mm)
    for seed in range(asked.seed, asked.seed + asked.logs):
        log = WholeLog.random(seed, rows=asked.rows)
        scan = whole_scan(log, log.truth(grid), VIEWS, asked.noise, grid)
        projector, lines = scan.projector, scan.lines
        first = max(asked.rows // 2 - SLICES_AROUND // 2, 0)
        weight = choose_weight(projector, lines[asked.rows // 2]).weight
        chosen = choose_coupling(projector, lines[first : first + SLICES_AROUND], weight)
        began = time.process_time()
        alone = total_variation(projector, lines, weight=weight).image
        middle = time.process_time()
        coupled = total_variation(projector, lines, weight=chosen.weight, coupling=chosen.coupling).image
        price = (time.process_time() - middle) / (middle - began)
        error = np.linalg.norm(coupled - scan.truth) / np.linalg.norm(alone - scan.truth)
        kept = {
            name: after / before
            for name in ("nail", "knot")
            if (before := scan.contrast(alone, name)) and (after := scan.contrast(coupled, name))
        }
        print(
            f"log {seed}, rows {log.row_pitch_mm:g} mm apart, {100.0 * asked.noise:g} % noise: coupling "
            f"{chosen.coupling:g}, error {error:.3f}, processor {price:.2f}, "
            + ", ".join(f"contrast of the {name} {share:.2f}" for name, share in kept.items()),
            flush=True,
        )


if __name__ == "__main__":
    main()
