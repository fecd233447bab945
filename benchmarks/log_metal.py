"""Nails in logs: what the treatment of metal leaves, by nail, method and number of views.

    python benchmarks/log_metal.py [--logs 2] [--seed 1] [--size 160] [--views 12 20 45 90] [--drift]

A row is a nail of steel, in the slice plane or across it, in logs of `nailed_logs.py`. For each method the relative
error of the slice with the nail, over that of the same slice without it: the mean over the logs, and the largest. The
error is the RMS difference from the wood, relative to the RMS of the wood, in all pixels at least two pixels away from
the nail. `as it is` is that of `metal: none`. The share is that of the samples taken for metal. The last line counts
false alarms in the logs without nails.

`--drift` takes rows with a nail as drift checks: errors of the centre of rotation in mm, and how often the intervals
of 95 % hold.
"""

import argparse
from collections.abc import Iterator

import numpy as np
from nailed_logs import SCANNER, THETA, Nail, NailedLog, views_all_round
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from sawmill_calibration import Scan, reconstruct
from sawmill_tomography.drift.change import DriftError
from sawmill_tomography.drift.detector_fit import detector_fit
from sawmill_tomography.geometry.geometry import FanBeamGeometry
from sawmill_tomography.projection.projector import Image
from sawmill_tomography.reconstruction.metal import MetalSearch
from sawmill_tomography.reconstruction.object_extent import object_radius_mm
from sawmill_tomography.reconstruction.quality import relative_error
from sawmill_vocabulary import MetalHandling, Rotation

FIELD_MM = 320.0
# Diameter in mm, length in mm (0 across the slice), attenuation as a multiple of the wood's.
NAILS = (
    *(Nail(diameter, 0.0, times) for diameter, times in ((2.0, 20.0), (4.0, 6.0), (6.0, 50.0))),
    *(Nail(diameter, 6.0, times) for diameter, times in ((2.0, 50.0), (4.0, 20.0))),
    *(Nail(diameter, 18.0, times) for diameter, times in ((2.0, 20.0), (3.2, 20.0), (3.2, 50.0), (6.0, 6.0))),
    *(Nail(diameter, 30.0, times) for diameter, times in ((3.2, 12.0), (3.2, 50.0), (6.0, 20.0), (6.0, 50.0))),
    *(Nail(*sizes, times) for sizes in ((2.8, 50.0), (3.4, 75.0), (4.2, 100.0)) for times in (20.0, 50.0)),
)
METHODS = ("fbp", "tikhonov", "total_variation")
DRIFT_NAILS = (Nail(3.6, 28.0, 20.0), Nail(3.6, 28.0, 40.0), Nail(5.0, 0.0, 30.0), Nail(2.8, 50.0, 40.0))
DRIFT_ROWS = 60
Cell = NDArray[np.float64]


def image_of(lines: Image, fan: FanBeamGeometry, method: str, metal: MetalHandling, size: int) -> Image:
    """Reconstruct a slice (size, size) as the command does."""
    given = Scan.from_arrays(lines, fan.angles_rad, SCANNER, from_counts=True)
    return reconstruct(given, THETA, method=method, size=size, field_mm=FIELD_MM, metal=metal).image


def ratios(log: NailedLog, fan: FanBeamGeometry, seed: int, size: int) -> tuple[float, Cell]:
    """Return the share of the samples taken for metal, and (methods, 2): errors over those without, treated and not."""
    lines, clean = (each.scan(fan, seed)[:, 0] for each in (log, log.plain))
    truth, metal = log.truth(size, FIELD_MM)
    wood = ~binary_dilation(metal, iterations=2)
    search = MetalSearch.of(fan, object_radius_mm(fan, lines))
    found = None if search is None else search.find(lines[None])[0]
    cases = ((clean, MetalHandling.NONE), (lines, MetalHandling.AUTO), (lines, MetalHandling.NONE))
    errors = np.array(
        [
            [relative_error(image_of(data, fan, method, metal, size)[wood], truth[wood]) for data, metal in cases]
            for method in METHODS
        ]
    )
    return 0.0 if found is None else float(found.trace.mean()), errors[:, 1:] / errors[:, :1]


def table(logs: int, seed: int, size: int, every: list[int]) -> Iterator[str]:
    """Yield the lines of the table."""
    yield "diameter length times views   share" + "".join(f"{name:>18s} (max, as it is)" for name in METHODS)
    treated = []
    for nail in NAILS:
        for views in every:
            fan = views_all_round(views)
            rows = [ratios(NailedLog.random(seed + n, nail), fan, seed + n, size) for n in range(logs)]
            share, found = np.mean([share for share, _ in rows]), np.array([each for _, each in rows])
            treated.append(found[:, :, 0].max(axis=0))
            columns = (
                f"{mean:18.2f} ({most:.2f}, {untreated:7.2f})"
                for (mean, untreated), most in zip(found.mean(axis=0), treated[-1], strict=True)
            )
            yield (f"{_numbers(nail)} {views:5d} {share:7.1%}" + "".join(columns))
    within = np.mean(np.array(treated) <= 1.5, axis=0)
    yield "rows at most 1.5 in every log: " + ", ".join(
        f"{name} {share:.0%}" for name, share in zip(METHODS, within, strict=True)
    )
    alarms = [found for n in range(10 * logs) for views in every if (found := _alarm(seed + n, views))]
    yield f"false alarms in logs without nails: {len(alarms)} of {10 * logs * len(every)}"


def _numbers(nail: Nail) -> str:
    return f"{nail.diameter_mm:8.1f} {nail.length_mm:6.0f} {nail.times_wood:5.0f}"


def _alarm(seed: int, views: int) -> bool:
    fan = views_all_round(views)
    lines = NailedLog.random(seed).scan(fan, seed)[:, 0]
    search = MetalSearch.of(fan, object_radius_mm(fan, lines))
    return search is not None and search.find(lines[None])[0] is not None


def drift_table(logs: int, seed: int, every: list[int]) -> Iterator[str]:
    """Yield the lines of the table of drift checks."""
    yield "diameter length times views  answered   error   sigma  held"
    for nail in (None, *DRIFT_NAILS):
        for views in every:
            fan, found = views_all_round(views), []
            for n in range(logs):
                log = NailedLog.random(seed + n, *(() if nail is None else (nail,)))
                mean = log.scan(fan, seed + n, DRIFT_ROWS).mean(axis=1, dtype=np.float64)
                try:
                    fit = detector_fit(SCANNER, mean, fan.angles_rad, fan.frame, Rotation.AS_GIVEN)
                except DriftError:
                    continue
                found.append((fit.cor_column_mm - fan.frame.cor_column_mm, fit.deviation[0]))
            errors, sigmas = np.array(found).T
            drawn = "no nail" if nail is None else _numbers(nail)
            yield (
                f"{drawn:>21s} {views:5d} {len(found):4d} of {logs:2d} {np.sqrt(np.mean(errors**2)):7.3f} "
                f"{np.median(sigmas):7.3f} {np.mean(np.abs(errors) < 1.96 * sigmas):5.0%}"
            )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--size", type=int, default=160)
    parser.add_argument("--views", type=int, nargs="+", default=[12, 20, 45, 90])
    parser.add_argument("--drift", action="store_true")
    asked = parser.parse_args()
    lines = (
        drift_table(asked.logs, asked.seed, asked.views)
        if asked.drift
        else table(asked.logs, asked.seed, asked.size, asked.views)
    )
    for line in lines:
        print(line, flush=True)


if __name__ == "__main__":
    main()
