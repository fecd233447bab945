"""The published L-phantom and simulated scans from 100 seeds: how far apart the answers are, and from the truth.

    python benchmarks/seeds.py [--seeds 100] [--picture OUT.png]

The last columns reconstruct a log by FBP from 360 views with each theta found, against its FBP with the true theta: the
largest relative error and the least SSIM of all seeds, on a simulated log and on the published one. The published
data's own floor is 0.05 to 0.06 mm: one ray a cell, and a drawing in pixels. --picture draws pairs of theta, next to
the published search's where `make paper` has left its runs in build/paper.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from paper.experiment import Plan
from paper.pairs import curve_units, pair_grid, thetas, twins
from paper.store import load
from rich.console import Console
from rich.progress import track
from scanners import SCANNER
from scans import ANGLES, TRUE_FRAME, TRUE_THETA, log_quality, published_l_phantom, simulated, sources

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.calibration import CalibrationOutcome
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import FloatArray, angle_difference, to_vector
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.built_in import L_SHAPE

NOISE = 0.02
RESULTS = Path("build/paper")


@dataclass(frozen=True)
class Study:
    """Sinograms of one kind, one for each seed, and what must be true of the answers."""

    name: str
    sinograms: list[FloatArray]
    angles: FloatArray
    target: str

    def answers(self) -> list[CalibrationOutcome]:
        """Calibrate once for each seed."""
        return [
            calibrate(CalibrationTask(SCANNER, L_SHAPE, sinogram, self.angles), seed=seed)
            for seed, sinogram in enumerate(
                track(self.sinograms, self.name, transient=True, console=Console(stderr=True))
            )
        ]


def studies(count: int) -> list[Study]:
    """List the studies: all 360 views and every 18th of each kind of scan."""
    exact = simulated(L_SHAPE, noise=0.0, seed=0)
    noisy = [simulated(L_SHAPE, noise=NOISE, seed=seed) for seed in range(count)]
    scans = {"simulated, exact": [exact] * count, f"simulated, {NOISE:.0%} noise": noisy}
    if "published" in sources():
        scans = {"published": [published_l_phantom()] * count} | scans
    return [
        Study(f"{name}, {360 // step} views", [scan[::step] for scan in made], ANGLES[::step], _target(name, step))
        for name, made in scans.items()
        for step in (1, 18)
    ]


def _target(name: str, step: int) -> str:
    if name == "published":
        return "0.08"
    return "0.01" if step == 1 else "0.04"


def line(study: Study, answers: list[CalibrationOutcome]) -> str:
    """Format one line of the table."""
    frames = [answer.frame for answer in answers]
    errors = [ray_error(SCANNER, TRUE_FRAME, frame).rms_mm for frame in frames]
    apart = max(ray_error(SCANNER, frames[0], frame).rms_mm for frame in frames)
    psi = max(abs(np.degrees(angle_difference(frame.psi_rad, TRUE_FRAME.psi_rad))) for frame in frames)
    text = f"{study.name:34s} {max(errors):11.4f} {study.target:>7s} {np.median(errors):11.4f} {apart:10.5f} {psi:9.4f}"
    for source in reversed(sources()):
        logs = [log_quality(source, answer.theta, answer.rotation) for answer in answers]
        text += f" {max(error for error, _ in logs):15.4f} {min(similarity for _, similarity in logs):8.4f}"
    return text


def draw(answers: list[CalibrationOutcome], path: Path) -> None:
    """Draw the pairs of theta: the published search's runs, where they are present, and the product's answers."""
    plan = Plan()
    curve = curve_units(plan, plan.dense_views)
    results = {unit.name: result for unit in curve if (result := load(RESULTS, unit)) is not None}
    done = [unit for unit in curve if unit.name in results]
    found = np.array([to_vector(answer.theta) for answer in answers])
    published = thetas(results, done) if done else np.zeros((0, 5))
    points = {
        "curve": published,
        "curve's twins": twins(published),
        "found": found,
        "twin": twins(found),
        "truth": to_vector(TRUE_THETA)[None],
    }
    pair_grid(points, path, f"L-phantom, 360 views, {len(answers)} seeds of the default calibration")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--picture", type=Path, metavar="OUT.png", help="draw the first scan's pairs of theta")
    options = parser.parse_args()
    logs = "".join(f" {source + ' log':>15s} {'SSIM':>8s}" for source in reversed(sources()))
    title = f"{options.seeds} seeds, mm and degrees"
    print(f"{title:34s} {'largest':>11s} {'target':>7s} {'median':>11s} {'apart':>10s} {'psi':>9s}{logs}")
    for number, study in enumerate(studies(options.seeds)):
        answers = study.answers()
        print(line(study, answers), flush=True)
        if options.picture is not None and number == 0:
            draw(answers, options.picture)
    print("targets of the rest: apart 0.02 (360 views), psi 0.1, a log's relative error at most 0.013, SSIM 0.995")


if __name__ == "__main__":
    main()
