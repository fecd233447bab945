"""The published L-phantom and simulated scans from 100 seeds: how far apart the answers are, and from the truth.

    python benchmarks/seeds.py [--seeds 100]

The published data's own floor is 0.05 to 0.06 mm: one ray a cell, and a drawing in pixels.
"""

import argparse
import os
from pathlib import Path

import numpy as np
from rich.progress import track
from scanners import SCANNER
from scipy.io import loadmat

from worker.tomography.analytic import DetectorCells, project
from worker.tomography.built_in import L_SHAPE
from worker.tomography.calibration.default import CalibrationTask, calibrate
from worker.tomography.geometry import TAU, FloatArray, SourceFrame, Theta, angle_difference
from worker.tomography.ray_error import ray_error

PUBLISHED_THETA = Theta(2.55023549, 714.683839, 319.943788, 43.6514375, 0.280799451)


def study(name: str, sinograms: list[FloatArray], angles: FloatArray, true: SourceFrame) -> None:
    """One line of the table; a sinogram may be the same for all seeds."""
    frames = []
    for seed, sinogram in enumerate(track(sinograms, description=name, transient=True)):
        frames.append(calibrate(CalibrationTask(SCANNER, L_SHAPE, sinogram, angles), seed=seed).frame)
    errors = [ray_error(SCANNER, true, frame).rms_mm for frame in frames]
    apart = [ray_error(SCANNER, frames[0], frame).rms_mm for frame in frames]
    psi = [abs(np.degrees(angle_difference(frame.psi_rad, true.psi_rad))) for frame in frames]
    print(f"{name:34s} {max(errors):12.4f} {np.median(errors):12.4f} {max(apart):16.5f} {max(psi):12.4f}")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=100)
    count = parser.parse_args().seeds
    true = PUBLISHED_THETA.source_frame(SCANNER.source_to_cor_mm)
    print(f"{count} seeds{'':27s} largest, mm   median, mm   apart at most, mm   psi, deg")
    published = Path(os.environ.get("SAWMILL_PUBLISHED_DATA", "../shared/data")) / "l-phantom" / "sinogram.mat"
    angles = (np.arange(360) + 0.5) * TAU / 360
    if published.is_file():
        sinogram = loadmat(published)["arr"].astype(np.float64)
        study("published, 360 views", [sinogram] * count, angles, true)
        study("published, 20 views", [sinogram[::18]] * count, angles[::18], true)
    clean = project(L_SHAPE, DetectorCells.of(SCANNER), true, angles, rays_per_cell=8)
    sigma = 0.02 * np.sqrt(np.mean(clean**2))
    noisy = [clean + sigma * np.random.default_rng(seed).standard_normal(clean.shape) for seed in range(count)]
    study("simulated, 2 % noise, 360 views", noisy, angles, true)
    study("simulated, 2 % noise, 20 views", [scan[::18] for scan in noisy], angles[::18], true)


if __name__ == "__main__":
    main()
