"""Ranking of the errors of the Cauchy MAP by quantities computed from a scan: why there is no uncertainty map.

Twelve simulated logs of three kinds in turn (thin bright rings, broad zones, smooth rings; choosing.py), 20 views of
768 cells, 1 to 4 % noise, 256 x 256 pixels, sigma and beta by the rule. Candidates for a map:

- gradient: the magnitude of the image's gradient, smoothed over 1.5 pixels;
- views: the spread of five images that each leave out a fifth of the views;
- method: the distance from the image of total variation, smoothed likewise;
- synthetic: the error with which four noisy scans of the image of total variation are reconstructed, likewise;
- together: the mean of the four ranks.

Prints, for each log, the rank correlation (Spearman) of each candidate with the absolute error, both averaged over
patches of 3 x 3 pixels (4.7 mm) that are all wood, and at the end the means of each kind of log and of all.

    python benchmarks/uncertainty.py [--logs 12] [--seed 8800]
"""

import argparse

import numpy as np
from choosing import smooth_log, zoned_log
from scanners import SCANNER
from scans import GRID, TRUE_THETA
from scipy.ndimage import gaussian_filter
from scipy.stats import rankdata, spearmanr

from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_tomography.reconstruction.cauchy_map import STRENGTH, cauchy_map
from sawmill_tomography.reconstruction.iterative.descent import Floats, Images
from sawmill_tomography.reconstruction.iterative.penalised import Objective, descend
from sawmill_tomography.reconstruction.iterative.priors import CauchyPrior
from sawmill_tomography.reconstruction.total_variation import total_variation
from sawmill_tomography.sinograms.noise import estimated_noise

VIEWS, FOLDS, SCANS, PATCH, SMOOTHED = 20, 5, 4, 3, 1.5
KINDS = ("thin rings", "zones", "smooth rings")
NAMES = ("gradient", "views", "method", "synthetic", "together")


def random_log(rng: np.random.Generator, kind: str, seed: int) -> Phantom:
    """Draw a log of one kind."""
    if kind == "zones":
        return zoned_log(rng)
    if kind == "smooth rings":
        return smooth_log(rng)
    radius, height = float(rng.uniform(100.0, 165.0)), float(rng.uniform(140.0, 260.0))
    return LogModel.random(seed, radius_mm=radius).slice_at(height)


def smoothed(image: Floats | Image) -> Floats:
    """Compute the root of the smoothed square."""
    return np.sqrt(gaussian_filter(np.square(image, dtype=np.float64), SMOOTHED))


def patches(image: Floats) -> Floats:
    """Compute means over patches."""
    n = len(image) // PATCH
    return image[: n * PATCH, : n * PATCH].reshape(n, PATCH, n, PATCH).mean(axis=(1, 3))


def near(projector: Projector, lines: Images, weights: Images, beta: float, start: Image) -> Images:
    """Compute the MAPs of several sinograms by descents from one image."""
    betas = np.full(len(weights), beta)
    prior = CauchyPrior(betas, np.full(len(weights), STRENGTH), betas)
    starts = np.repeat(start[None], len(weights), axis=0)
    objective = Objective(projector, lines, weights, prior)
    return descend(objective, starts, non_negative=True, iterations=15, tolerance=1e-4).images


def correlations(kind: str, seed: int) -> list[float]:
    """Compute for one log each candidate's rank correlation with the error."""
    rng = np.random.default_rng(seed)
    noise, log = rng.uniform(0.01, 0.04), random_log(rng, kind, seed)
    geometry = FanBeamGeometry(SCANNER, TRUE_THETA, (np.arange(VIEWS) + rng.uniform()) * TAU / VIEWS)
    projector, truth = Projector(geometry, GRID), log.rasterise(GRID.size, GRID.field_mm)
    lines = projector.block(simulate_sinogram(log, geometry, noise=noise, seed=seed))
    found, other = cauchy_map(projector, lines[0]), total_variation(projector, lines[0]).image
    image, beta = found.image, float(found.parameters["beta"][0])
    weights = np.full(lines.shape, 1.0 / found.parameters["sigma"][0] ** 2, np.float32)
    left_out = np.repeat(weights, FOLDS, axis=0)
    for fold in range(FOLDS):
        left_out[fold, fold::FOLDS] = 0.0
    folds = near(projector, lines, left_out, beta, image)
    drawn = estimated_noise(lines[0]) * rng.standard_normal((SCANS, *lines.shape[1:]))
    scans = projector.forward(other[None]) + drawn.astype(np.float32)
    again = near(projector, scans, np.repeat(weights, SCANS, axis=0), beta, other)
    maps = [
        gaussian_filter(np.hypot(*np.gradient(image)), SMOOTHED),
        folds.std(axis=0),
        smoothed(image - other),
        smoothed(np.sqrt(np.mean((again - other) ** 2, axis=0))),
    ]
    wood = patches((truth > 0.3 * np.median(truth[truth > 0.0])).astype(float)) > 0.99
    ranks = [rankdata(patches(one)[wood]) for one in maps]
    error = patches(np.abs(image - truth))[wood]
    return [float(spearmanr(one, error).statistic) for one in (*ranks, np.mean(ranks, axis=0))]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=int, default=12)
    parser.add_argument("--seed", type=int, default=8800)
    options = parser.parse_args()
    print(f"{'log':14s}" + "".join(f"{name:>11s}" for name in NAMES))
    found: dict[str, list[list[float]]] = {kind: [] for kind in KINDS}
    for index in range(options.logs):
        kind = KINDS[index % len(KINDS)]
        row = correlations(kind, options.seed + index)
        found[kind].append(row)
        print(f"{kind:14s}" + "".join(f"{value:11.2f}" for value in row), flush=True)
    every = [row for rows in found.values() for row in rows]
    for kind, rows in (*((kind, rows) for kind, rows in found.items() if rows), ("all", every)):
        print(f"mean {kind:9s}" + "".join(f"{value:11.2f}" for value in np.mean(rows, axis=0)))


if __name__ == "__main__":
    main()
