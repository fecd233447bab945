"""Errors when the model is wrong on purpose, with the answer's bounds, and whether the answer reports the fault.

    python benchmarks/misspecified.py [--scans 40] [--seed 1] [--only NAME]

Each kind of wrong model is tried on random scanners with 0.2 to 2 % noise, blind. The table shows the median of the
true RMS ray error and of what was predicted, the share of scans whose error stayed below its predicted 95 % bound, by
itself and with twice what the phantom's size tolerance adds (no residual shows a wrong size), the median inflation, the
share of scans that passed, the share that passed with an error above the tolerance, and the share of which something
was reported or adjusted; then the most frequent beginnings of these sentences.
"""

import argparse
import math
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from rich.progress import track
from scanners import SCANNER, RandomScan, random_scan
from scipy.ndimage import gaussian_filter1d

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.calibration import CalibrationOutcome
from sawmill_tomography.calibration.errors import CalibrationError
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import TAU, FloatArray
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM
from sawmill_tomography.phantoms.phantom import Disc, Phantom, Polygon
from sawmill_tomography.phantoms.tracing import trace
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_vocabulary import Handedness

RAYS = 8
FIELD_MM = 400.0
NOISES = (0.002, 0.02)
WORDS = 30
# Default tolerance at which a calibration passes.
TOLERANCE_MM = 0.1


@dataclass(frozen=True)
class Made:
    """A scan that differs from the model: the task's content, with the fault in it."""

    sinogram: FloatArray
    drawn: Phantom
    from_counts: bool = False


def exact(scan: RandomScan, _: np.random.Generator) -> Made:
    """Make a scan without any fault."""
    return Made(shadow(scan, scan.task.phantom), scan.task.phantom)


def coarse_drawing(scan: RandomScan, rng: np.random.Generator) -> Made:
    """Trace the phantom from a picture with pixels of 2 to 3 mm, black or white."""
    size = round(FIELD_MM / rng.uniform(2.0, 3.0))
    picture = scan.task.phantom.rasterise(size, FIELD_MM, subsamples=1)
    return Made(shadow(scan, scan.task.phantom), trace(picture, FIELD_MM, name="picture"))


def blur(scan: RandomScan, rng: np.random.Generator) -> Made:
    """Blur by the focal spot and the scintillator: a Gaussian of one to three cells."""
    return Made(_blurred(shadow(scan, scan.task.phantom), rng), scan.task.phantom)


def hardening(scan: RandomScan, rng: np.random.Generator) -> Made:
    """Harden the beam: y + c y^2, by 2 to 10 % on the longest path."""
    sinogram = shadow(scan, scan.task.phantom)
    return Made(sinogram - rng.uniform(0.02, 0.1) / sinogram.max() * sinogram**2, scan.task.phantom)


def rounded_corner(scan: RandomScan, rng: np.random.Generator) -> Made:
    """Round one corner of the wood by 5 to 10 mm."""
    radius = rng.uniform(5.0, 10.0)
    worn = replace(scan.task.phantom, shapes=tuple(rounded(s, radius, rng) for s in scan.task.phantom.shapes))
    return Made(shadow(scan, worn), scan.task.phantom)


def knot(scan: RandomScan, rng: np.random.Generator) -> Made:
    """Add a knot of 8 to 16 mm, denser by a fifth to a half."""
    inside = point_inside(scan.task.phantom, rng)
    grown = Disc(inside, rng.uniform(8.0, 16.0), rng.uniform(0.2, 0.5))
    return Made(shadow(scan, scan.task.phantom, grown), scan.task.phantom)


def growth_rings(scan: RandomScan, rng: np.random.Generator) -> Made:
    """Add rings of late wood every 8 mm round a pith inside, denser by a tenth to a fifth where they stay inside."""
    pith = point_inside(scan.task.phantom, rng)
    density = rng.uniform(0.1, 0.2)
    rings = [
        Disc(pith, radius, sign * density)
        for radius in range(8, 41, 8)
        for sign, radius in ((1, radius), (-1, radius - 3))
    ]
    return Made(shadow(scan, scan.task.phantom, *rings), scan.task.phantom)


def counts(scan: RandomScan, _: np.random.Generator) -> Made:
    """Average intensities in each cell, and state that the data are counts."""
    wood = scan.task.phantom.of_density(SAPWOOD_PER_MM)
    cells = DetectorCells.of(SCANNER)
    fine = DetectorCells(cells.first_border_mm, cells.width_mm / RAYS, cells.count * RAYS)
    rays = shadow(scan, wood, cells=fine, rays=1).reshape(-1, cells.count, RAYS)
    return Made(-np.log(np.exp(-rays).mean(axis=2)), scan.task.phantom, from_counts=True)


def blur_and_hardening(scan: RandomScan, rng: np.random.Generator) -> Made:
    """Harden each ray, then blur by the detector."""
    hardened = hardening(scan, rng)
    return replace(hardened, sinogram=_blurred(hardened.sinogram, rng))


def slipped(scan: RandomScan, rng: np.random.Generator) -> Made:
    """Move the phantom from some view on, by 0.1 to 10 mm and a tenth as many degrees."""
    before = shadow(scan, scan.task.phantom)
    mm, towards = math.exp(rng.uniform(*np.log((0.1, 10.0)))), rng.uniform(0.0, TAU)
    turned = replace(scan.frame, psi_rad=scan.frame.psi_rad + math.radians(0.1 * mm) * rng.choice((-1.0, 1.0)))
    after = shadow(
        replace(scan, frame=turned),
        scan.task.phantom,
        position_mm=(mm * math.cos(towards), mm * math.sin(towards)),
    )
    view = round(rng.uniform(0.2, 0.8) * len(before))
    return Made(np.concatenate([before[:view], after[view:]]), scan.task.phantom)


def wrong_pace(scan: RandomScan, rng: np.random.Generator) -> Made:
    """Turn the turntable 0.02 to 2 % further, or less far, than the angles state."""
    pace = 1.0 + math.exp(rng.uniform(*np.log((2e-4, 0.02)))) * rng.choice((-1.0, 1.0))
    return Made(shadow(scan, scan.task.phantom, angles_rad=pace * scan.task.angles_rad), scan.task.phantom)


def swinging_encoder(scan: RandomScan, rng: np.random.Generator) -> Made:
    """Shift the angles ahead and behind once a turn, by 0.02 to 2 degrees."""
    swing = math.radians(math.exp(rng.uniform(*np.log((0.02, 2.0)))))
    angles = scan.task.angles_rad
    return Made(
        shadow(scan, scan.task.phantom, angles_rad=angles + swing * np.cos(angles - rng.uniform(0.0, TAU))),
        scan.task.phantom,
    )


KINDS: dict[str, Callable[[RandomScan, np.random.Generator], Made]] = {
    "nothing wrong": exact,
    "coarse drawing": coarse_drawing,
    "blur": blur,
    "beam hardening": hardening,
    "rounded corner": rounded_corner,
    "knot": knot,
    "growth rings": growth_rings,
    "counts": counts,
    "blur and hardening": blur_and_hardening,
    "phantom slipped": slipped,
    "wrong pace": wrong_pace,
    "swinging encoder": swinging_encoder,
}


def shadow(
    scan: RandomScan,
    body: Phantom,
    *more: Disc,
    cells: DetectorCells | None = None,
    rays: int = RAYS,
    angles_rad: FloatArray | None = None,
    position_mm: tuple[float, float] = (0.0, 0.0),
) -> FloatArray:
    """Project a body, and inclusions added to it, as the scan's scanner sees it: the sinogram."""
    whole = replace(body, shapes=(*body.shapes, *more))
    seen = whole if scan.handedness is Handedness.AS_DRAWN else whole.mirrored()
    angles = scan.rotation.apply(scan.task.angles_rad if angles_rad is None else angles_rad)
    detector = cells or DetectorCells.of(SCANNER)
    return analytic.project(seen, detector, scan.frame, angles, position_mm=position_mm, rays_per_cell=rays)


def _blurred(sinogram: FloatArray, rng: np.random.Generator) -> FloatArray:
    soft: FloatArray = gaussian_filter1d(sinogram, rng.uniform(1.0, 3.0), axis=1, mode="nearest")
    return soft


def rounded(shape: Polygon | Disc, radius: float, rng: np.random.Generator) -> Polygon | Disc:
    """Replace one of a polygon's corners by an arc of eight chords."""
    if isinstance(shape, Disc):
        return shape
    corners = np.array(shape.vertices_mm)
    index = int(rng.integers(len(corners)))
    before, corner, after = corners[index - 1], corners[index], corners[(index + 1) % len(corners)]
    a, b = (before - corner) / np.hypot(*(before - corner)), (after - corner) / np.hypot(*(after - corner))
    half = 0.5 * math.acos(float(np.clip(a @ b, -1.0, 1.0)))
    centre = corner + radius / math.sin(half) * (a + b) / np.hypot(*(a + b))
    start, stop = corner + radius / math.tan(half) * a - centre, corner + radius / math.tan(half) * b - centre
    first = math.atan2(start[1], start[0])
    turn = math.remainder(math.atan2(stop[1], stop[0]) - first, 2.0 * math.pi)
    bends = first + turn * np.linspace(0.0, 1.0, 9)
    arc = centre + radius * np.stack([np.cos(bends), np.sin(bends)], -1)
    rounded = [*corners[:index].tolist(), *arc.tolist(), *corners[index + 1 :].tolist()]
    return replace(shape, vertices_mm=tuple((x, y) for x, y in rounded))


def point_inside(body: Phantom, rng: np.random.Generator) -> tuple[float, float]:
    """Draw a point at least 25 mm or so inside the wood."""
    image = body.rasterise(80, FIELD_MM)
    full = np.lib.stride_tricks.sliding_window_view(image, (9, 9)).min(axis=(2, 3)) > 0.99
    where = np.argwhere(full)
    i, j = where[rng.integers(len(where))] + 4
    return float((i + 0.5) * 5.0 - 200.0), float((j + 0.5) * 5.0 - 200.0)


def noisy_task(scan: RandomScan, made: Made, rng: np.random.Generator) -> CalibrationTask:
    """Add noise and return the task for the calibration."""
    noise = math.exp(rng.uniform(*np.log(NOISES)))
    spread = noise * np.sqrt(np.mean(made.sinogram**2))
    measured = made.sinogram + spread * rng.standard_normal(made.sinogram.shape)
    return CalibrationTask(SCANNER, made.drawn, measured, scan.task.angles_rad, from_counts=made.from_counts)


@dataclass
class Tally:
    """The results for the scans of one kind."""

    errors: list[float] = field(default_factory=list)
    predicted: list[float] = field(default_factory=list)
    covered: list[bool] = field(default_factory=list)
    with_size: list[bool] = field(default_factory=list)
    inflations: list[float] = field(default_factory=list)
    spoken: list[bool] = field(default_factory=list)
    verdicts: Counter[str] = field(default_factory=Counter)
    sentences: Counter[str] = field(default_factory=Counter)
    wrong: int = 0

    def add(self, scan: RandomScan, found: CalibrationOutcome) -> None:
        """Record one answer."""
        assert found.findings.error_bars is not None
        predicted = found.findings.error_bars.predicted_ray_error
        error = ray_error(SCANNER, scan.frame, found.frame, other_scanner=found.scanner).rms_mm
        self.errors.append(error)
        self.predicted.append(predicted.rms_mm)
        self.covered.append(error <= predicted.upper_95_mm)
        self.with_size.append(error <= predicted.upper_95_mm + 2.0 * found.findings.scale.ray_error_mm)
        self.inflations.append(found.findings.error_bars.inflation)
        self.verdicts[found.judgement.verdict] += 1
        self.wrong += found.judgement.verdict == "pass" and error > TOLERANCE_MM
        sentences = (
            *(reason for reason in found.judgement.reasons if "source shift" not in reason),
            *found.adjustments,
        )
        self.spoken.append(bool(sentences))
        for sentence in sentences:
            self.sentences[re.sub(r"[-+]?\d[\d.]*%?", "#", sentence)[:WORDS]] += 1

    def row(self, name: str) -> str:
        """Format one line of the table."""
        shared = sum(self.verdicts.values())
        return (
            f"{name:20s} {np.median(self.errors):7.4f} {np.max(self.errors):7.4f} {np.median(self.predicted):9.4f} "
            f"{np.mean(self.covered):7.1%} {np.mean(self.with_size):9.1%} {np.median(self.inflations):9.2f} "
            f"{self.verdicts['pass'] / shared:7.1%} {self.wrong / shared:7.1%} {np.mean(self.spoken):7.1%}"
        )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scans", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=tuple(KINDS))
    options = parser.parse_args()
    tallies = {name: Tally() for name in KINDS if options.only in {None, name}}
    for name, tally in tallies.items():
        rng = np.random.default_rng(options.seed)
        for number in track(range(options.scans), description=name):
            scan = random_scan(rng)
            made = KINDS[name](scan, rng)
            try:
                tally.add(scan, calibrate(noisy_task(scan, made, rng), seed=number))
            except CalibrationError as error:
                tally.verdicts[error.code] += 1
    noises = f"noise {NOISES[0]:.1%} to {NOISES[1]:.1%} of the RMS"
    print(f"{options.scans} random scanners each, {noises}, seed {options.seed}")
    print(
        f"{'':20s} {'error':>7s} {'largest':>7s} {'predicted':>9s} {'covered':>7s} {'with size':>9s} "
        f"{'inflation':>9s} {'passed':>7s} {'wrongly':>7s} {'reported':>8s}"
    )
    for name, tally in tallies.items():
        print(tally.row(name))
        for sentence, count in tally.sentences.most_common(2):
            print(f"    {count:4d} x {sentence} ...")


if __name__ == "__main__":
    main()
