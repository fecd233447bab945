"""Metal in phantoms, and phantoms without: what is found, what is left of the error, and false alarms.

    python benchmarks/metal.py [--scans 40] [--seed 1] [--wood 0.005]

Scans in counts as in benchmarks/counted.py, 2 000 to 50 000 photons and 20 to 360 views. The phantom holds one to
four screws of 3 to 6 mm, or a bracket of 30 to 60 by 2 to 4 mm, steel 12 to 100 times as dense as the wood; or it is
sound; or one of that module's other faults is there. The table shows the scans that were refused, those in which metal
was reported, the median and the largest true ray error, and how often the predicted bound held.
"""

import argparse
import math
from collections.abc import Callable
from dataclasses import replace

import counted
import numpy as np
from counted import FAULTS, Fault, counted_scan
from misspecified import point_inside
from rich.progress import track
from scanners import SCANNER

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.errors import CalibrationError
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.phantom import Disc, Phantom, Polygon

PHOTONS = (2_000.0, 50_000.0)
STEEL = (12.0, 100.0)


def screws(body: Phantom, rng: np.random.Generator) -> Phantom:
    """Add one to four screws across the slice."""
    found = [Disc(point_inside(body, rng), rng.uniform(1.5, 3.0), _steel(rng)) for _ in range(rng.integers(1, 5))]
    return replace(body, shapes=(*body.shapes, *found))


def bracket(body: Phantom, rng: np.random.Generator) -> Phantom:
    """Add a strip of steel on edge."""
    (x, y), turn = point_inside(body, rng), rng.uniform(0.0, math.pi)
    length, thickness = rng.uniform(15.0, 30.0), rng.uniform(1.0, 2.0)
    c, s = math.cos(turn), math.sin(turn)
    corners = ((-length, -thickness), (length, -thickness), (length, thickness), (-length, thickness))
    strip = Polygon(tuple((x + c * u - s * v, y + s * u + c * v) for u, v in corners), _steel(rng))
    return replace(body, shapes=(*body.shapes, strip))


def _steel(rng: np.random.Generator) -> float:
    return math.exp(rng.uniform(*np.log(STEEL))) - 1.0


def any_fault(rng: np.random.Generator) -> Fault:
    """Draw a fault other than metal."""
    return list(FAULTS.values())[rng.integers(len(FAULTS))]


KINDS: dict[str, Callable[[np.random.Generator], Fault]] = {
    "screws": lambda _: Fault(body=screws),
    "bracket": lambda _: Fault(body=bracket),
    "sound": lambda _: Fault(),
    "other faults": any_fault,
}


def row(name: str, scans: int, seed: int) -> str:
    """Compute one line of the table."""
    errors, held, reported, refused = [], [], 0, 0
    for number in track(range(scans), description=name):
        rng = np.random.default_rng([seed, list(KINDS).index(name), number])
        scan = counted_scan(rng, fault=KINDS[name](rng))
        try:
            found = calibrate(scan.task())
        except CalibrationError:
            refused += 1
            continue
        assert found.findings.error_bars is not None
        errors.append(ray_error(SCANNER, scan.frame, found.frame, other_scanner=found.scanner).rms_mm)
        held.append(errors[-1] <= found.findings.error_bars.predicted_ray_error.upper_95_mm)
        reported += any(sentence.startswith("Metal") for sentence in found.adjustments)
    return (
        f"{name:13s} {scans:5d} {refused:8d} {reported:9d} {np.median(errors):8.3f} {np.max(errors):8.3f} "
        f"{np.mean(held):6.0%}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--scans", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--wood", type=float, default=0.005)
    asked = parser.parse_args()
    counted.SAPWOOD_PER_MM, counted.PHOTONS = asked.wood, PHOTONS
    rows = [row(name, asked.scans, asked.seed) for name in KINDS]
    print("kind          scans  refused     metal   median  largest   held")
    print("\n".join(rows))


if __name__ == "__main__":
    main()
