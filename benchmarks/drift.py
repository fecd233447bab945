"""Drift without a phantom: how far off, how honest its error bars, how often there is no answer. Simulated logs.

    python benchmarks/drift.py [--scans 150] [--seed 1]

Every scan has its own scanner, log, number of views (120, 180, 360 or 720) and noise (0.5 to 4 % of the RMS, or
counts with 3 000 to 30 000 photons in air). Prints for each kind of scan the share without an answer, the RMS errors,
how often value +- 1.96 standard deviations held the truth, false alarms of drift (against the truth), and scans whose
turn is called disturbed.
"""

import argparse
import math
from collections import Counter, defaultdict
from dataclasses import dataclass, field, replace

import numpy as np
from mill_logs import DISTANCE_ERROR_MM
from rich.progress import track
from scanners import SCANNER

from sawmill_tomography.drift.change import ConjugateFit, DriftError, drift_change, seen_vector
from sawmill_tomography.drift.opposite_rays.conjugate_rays import conjugate_fit
from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, FloatArray, SourceFrame, Theta
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.preparing.line_integrals import line_integrals
from sawmill_tomography.projection.analytic import DetectorCells, project
from sawmill_tomography.projection.simulate import simulate_sinogram, simulate_stack

KINDS = (
    "off centre",
    "exactly centred",
    "counts",
    "gain of each view 1 %",
    "faulty cells and views",
    "nails",
    "encoder 0.2 degrees",
    "bearing 1 mm twice",
)
STEEL_PER_MM = 0.3
VIEWS = (120, 180, 360, 720)


@dataclass
class Tally:
    """The results of the scans of one kind."""

    scans: int = 0
    held: int = 0
    alarms: int = 0
    disturbed: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    errors: list[FloatArray] = field(default_factory=list)
    deviations: list[FloatArray] = field(default_factory=list)

    def add(self, fit: ConjugateFit, truth: SourceFrame) -> None:
        """Count an answer; an SDD that was held is none."""
        error, deviation = seen_vector(fit) - seen_vector(truth), fit.deviation
        deviation[:2] = np.hypot(deviation[:2], DISTANCE_ERROR_MM * fit.distance_sensitivity)
        self.alarms += drift_change(SCANNER, truth, None, fit).moved
        self.disturbed += bool(fit.disturbances)
        if fit.distance_held:
            self.held += 1
            error[2] = deviation[2] = math.nan
        self.errors.append(error)
        self.deviations.append(deviation)

    def line(self) -> str:
        """Format RMS and median errors, coverage, refusals."""
        if not self.errors:
            return f"{self.scans:5d}  no answers"
        error, deviation = np.array(self.errors), np.array(self.deviations)
        error[:, 1], deviation[:, 1] = np.rad2deg(error[:, 1]), np.rad2deg(deviation[:, 1])
        seen = np.isfinite(error)
        inside = [np.mean(np.abs(e[s]) <= 1.96 * d[s]) for e, d, s in zip(error.T, deviation.T, seen.T, strict=True)]
        rms = np.sqrt(np.nanmean(error**2, axis=0))
        median = np.nanmedian(np.abs(error), axis=0)
        answers = len(error)
        return (
            f"{self.scans:5d}  {1.0 - answers / self.scans:7.1%}  {self.held / answers:5.0%}   "
            + "  ".join(f"{r:7.4f} ({m:.4f})" for r, m in zip(rms, median, strict=True))
            + "   "
            + " ".join(f"{share:6.1%}" for share in inside)
            + f"  {self.alarms:6d} {self.disturbed:9d}"
        )


def random_log(rng: np.random.Generator, seed: int) -> Phantom:
    """Draw a cross-section of a log, its outline on the centre of rotation."""
    return LogModel.random(seed, radius_mm=rng.uniform(90.0, 140.0)).slice_at(rng.uniform(40.0, 360.0))


def random_scan(rng: np.random.Generator, kind: str, seed: int) -> tuple[FloatArray, FanBeamGeometry]:
    """Simulate a noisy sinogram (views, cells) of a kind, with the geometry that made it."""
    theta = Theta(*rng.uniform([0.0, 600.0, -300.0, -100.0, -0.3], [TAU, 850.0, 300.0, 100.0, 0.3]))
    views = int(rng.choice(VIEWS))
    fan = FanBeamGeometry(SCANNER, theta, (np.arange(views) + rng.uniform()) * TAU / views)
    body = random_log(rng, seed)
    if kind != "exactly centred":
        body = body.moved(*rng.uniform(-15.0, 15.0, 2))
    if kind in {"encoder 0.2 degrees", "bearing 1 mm twice"}:
        return disturbed(body, fan, kind, rng), fan
    if kind == "nails":
        turn, depth = rng.uniform(0.0, TAU, number := int(rng.integers(1, 6))), rng.uniform(20.0, 85.0, 5)
        places = [(d * math.cos(t), d * math.sin(t)) for t, d in zip(turn, depth[:number], strict=True)]
        nails = (Disc(place, rng.uniform(1.0, 4.0), STEEL_PER_MM) for place in places)
        body = Phantom("nailed", (*body.shapes, *nails))
    if kind in {"counts", "nails"}:
        stack = simulate_stack([body], fan, photons=10.0 ** rng.uniform(3.5, 4.5), seed=seed)
        counts, flats, darks = (frames.astype(np.float32) for frames in vars(stack).values())
        return line_integrals(counts, flats, darks).stack[:, 0].astype(np.float64), fan
    sinogram = simulate_sinogram(body, fan, noise=rng.uniform(0.005, 0.04), rays_per_cell=4, seed=seed)
    if kind == "gain of each view 1 %":
        sinogram *= 1.0 + 0.01 * rng.standard_normal((views, 1))
    if kind == "faulty cells and views":
        cells, odd = rng.choice(SCANNER.num_detector_pixels, 3, replace=False), rng.choice(views, 2, replace=False)
        sinogram[:, cells] = [0.0, 1.5 * sinogram.max(), 0.0]
        sinogram[odd] = [np.full(SCANNER.num_detector_pixels, sinogram.max()), np.roll(sinogram[odd[1]], 40)]
    return sinogram, fan


def disturbed(body: Phantom, fan: FanBeamGeometry, kind: str, rng: np.random.Generator) -> FloatArray:
    """Simulate a noisy sinogram with angles wrong once a turn, or a log that swings across the beam twice a turn."""
    phase, cells = rng.uniform(0.0, TAU), DetectorCells.of(SCANNER)
    encoder = kind.startswith("encoder")
    true = fan.angles_rad + (math.radians(0.2) * np.cos(fan.angles_rad - phase) if encoder else 0.0)
    swing = np.zeros_like(true) if encoder else np.cos(2.0 * fan.angles_rad - phase)
    across = true + fan.frame.psi_rad
    places = np.stack([swing * np.cos(across), swing * np.sin(across)], axis=1)
    views = (
        project(body, cells, fan.frame, true[k : k + 1], position_mm=(float(x), float(y)), rays_per_cell=4)
        for k, (x, y) in enumerate(places)
    )
    clean = np.concatenate(list(views))
    noise = rng.uniform(0.005, 0.04) * math.sqrt(float(np.mean(clean**2)))
    return clean + noise * rng.standard_normal(clean.shape)


def near(truth: SourceFrame, rng: np.random.Generator) -> SourceFrame:
    """Draw a calibration from before a drift of about a millimetre."""
    return replace(
        truth,
        cor_column_mm=truth.cor_column_mm + rng.normal(0.0, 1.0),
        tilt_rad=truth.tilt_rad + rng.normal(0.0, 0.003),
        source_to_detector_mm=truth.source_to_detector_mm + rng.normal(0.0, DISTANCE_ERROR_MM),
    )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scans", type=int, default=150)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    tallies: dict[str, Tally] = defaultdict(Tally)
    for number in track(range(options.scans), description="scans"):
        kind = KINDS[number % len(KINDS)]
        sinogram, fan = random_scan(rng, kind, 10_000 * options.seed + number)
        groups = [tallies[name] for name in (kind, f"{fan.angles_rad.size} views", "all")]
        for tally in groups:
            tally.scans += 1
        try:
            fit = conjugate_fit(SCANNER, sinogram, fan.angles_rad, near(fan.frame, rng))
        except DriftError as refusal:
            for tally in groups:
                tally.refused[refusal.code] += 1
            continue
        for tally in groups:
            tally.add(fit, fan.frame)
    print(f"{options.scans} scans, seed {options.seed}; RMS error (median of its absolute value); 95 % intervals")
    columns = "u_c, mm           tau, degrees      SDD, mm            u_c    tau    SDD  alarms  disturbed"
    print(f"{'':24s}scans  refused   held   {columns}")
    for name in (*KINDS, *(f"{views} views" for views in VIEWS), "all"):
        print(f"{name:24s}{tallies[name].line()}  {dict(tallies[name].refused) or ''}")


if __name__ == "__main__":
    main()
