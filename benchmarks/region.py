"""A region of interest over a knot: its error and its price compared with the whole image's.

Simulated logs (`whole_logs.py`, three kinds of rings), 2 % noise, one thread. Prints each method's relative error in
the field, cut out of the whole image and reconstructed as a region, and processor seconds of both, with everything that
is chosen; of `fbp` the largest difference and the processor seconds of the back-projection alone.

    python benchmarks/region.py [--size 512] [--part 8] [--views 20 360] [--logs 3] [--noise 0.02]
        [--methods fbp total_variation tikhonov cauchy_map]
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from log_methods import reconstruct_rows
from log_scans import LogScan, whole_scan
from numba import set_num_threads
from whole_logs import TABLE_SEED, Rows, WholeLog

from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction import _fbp_numba as kernels
from sawmill_tomography.reconstruction.fbp import Preparation
from sawmill_tomography.reconstruction.quality import relative_error
from sawmill_vocabulary import FilterName

FIELD_MM, ROWS = 400.0, 4


def over_a_knot(log: WholeLog, grid: ImageGrid, size: int) -> tuple[int, tuple[slice, slice]]:
    """Select the row that shows most of the small knot, and the square of pixels around the knot."""
    shares = log.inclusion_alone("knot", grid)
    row = int(shares.sum(axis=(1, 2)).argmax())
    low = [int(np.mean(places)) - size // 2 for places in np.nonzero(shares[row] > 0.5)]
    return row, (slice(low[0], low[0] + size), slice(low[1], low[1] + size))


def timed(work: Callable[[], Rows]) -> tuple[Rows, float]:
    """Return the work's rows, and the processor seconds."""
    start = time.process_time()
    return work(), time.process_time() - start


def region_of(grid: ImageGrid, part: tuple[slice, slice]) -> ImageGrid:
    """Return the grid of a square of pixels of another grid."""
    size, h = part[0].stop - part[0].start, grid.pixel_mm
    low = [end + h * along.start for end, along in zip(grid.low_mm, part, strict=True)]
    return ImageGrid(size, size * h, (low[0] + 0.5 * size * h, low[1] + 0.5 * size * h))


def back_projection_s(projector: Projector, repeats: int = 5) -> float:
    """Measure the processor seconds of the back-projection of a block of sixteen slices, the least of some."""
    frame = Preparation.of(projector, "exact", FilterName.HANN, 1.0).frame
    views, cells = projector.geometry.sinogram_shape
    rows, size = np.ones((views, cells + 2, 16), np.float32), projector.grid.size
    volume = np.empty((16, size, size), np.float32)
    kernels.back_project_16(rows, *frame, volume)
    return min(timed(lambda: kernels.back_project_16(rows, *frame, volume))[1] for _ in range(repeats))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=512, help="pixels along a side of the whole image")
    parser.add_argument("--part", type=int, default=8, help="the region's side is this part of it")
    parser.add_argument("--views", type=int, nargs="+", default=[20, 360])
    parser.add_argument("--logs", type=int, default=3)
    parser.add_argument("--noise", type=float, default=0.02)
    parser.add_argument("--methods", nargs="+", default=["fbp", "total_variation", "tikhonov", "cauchy_map"])
    asked = parser.parse_args()
    set_num_threads(1)
    grid = ImageGrid(asked.size, FIELD_MM)
    for views in asked.views:
        for seed in range(TABLE_SEED, TABLE_SEED + asked.logs):
            log = WholeLog.random(seed, rows=ROWS)
            row, part = over_a_knot(log, grid, asked.size // asked.part)
            one = replace(log, heights_mm=log.heights_mm[row : row + 1])
            scan = whole_scan(one, one.truth(grid), views, asked.noise, grid)
            for method in asked.methods:
                print(compared(scan, method, part))
    if "fbp" in asked.methods:
        whole, region = (
            back_projection_s(Projector(scan.projector.geometry, pixels)) for pixels in (grid, region_of(grid, part))
        )
        print(f"back-projection of 16 slices: whole {whole:.4f} s, region {region:.4f} s, 1 / {whole / region:.1f}")


def compared(scan: LogScan, method: str, part: tuple[slice, slice]) -> str:
    """Format a row of the table."""
    region = region_of(scan.projector.grid, part)
    asked = {"method": method, "metal": "none"}
    field = {"size": region.size, "field_mm": region.field_mm, "field_centre_mm": region.centre_mm}
    whole, dear_s = timed(lambda: reconstruct_rows(scan, scan.lines, **asked)[0])
    own, cheap_s = timed(lambda: reconstruct_rows(scan, scan.lines, **asked, **field)[0])
    cut, truth = whole[0][part], scan.truth[0][part]
    errors = [relative_error(image, truth) for image in (cut, own[0])]
    apart = np.abs(own[0] - cut).max() / np.abs(cut).max()
    return (
        f"{scan.projector.geometry.angles_rad.size:4d} views, log {scan.name}, {method:15s} error there: whole "
        f"{errors[0]:.4f}, region {errors[1]:.4f}, ratio {errors[1] / errors[0]:.3f}; apart by {apart:.1e}; processor "
        f"seconds: {dear_s:.2f} and {cheap_s:.2f}"
    )


if __name__ == "__main__":
    main()
