"""How well the Cauchy MAP chooses sigma and beta by itself: simulated logs against the best of a grid, truth in hand.

Logs of two kinds (thin bright rings, and broad zones), other scanners than the published one, 17 to 90 views, 1 to 4 %
noise, a third of the scans at irregular angles, in units that differ by a factor of thirty. The data are analytic,
averaged over the detector's cells; the truth is the phantom's mean in each pixel. Prints a row for each log: relative
error by the rule and with the best of sixteen pairs (sigma, beta), their ratio, the pair, and what total variation with
the weight by its own rule reaches beside it: relative error, how far its edges are off, SSIM.

    python benchmarks/choosing.py [--logs 12] [--size 128] [--seed 400]
"""

import argparse
import math
import time

import numpy as np

from worker.tomography.cauchy_map import STRENGTH, cauchy_map
from worker.tomography.geometry import TAU, FanBeamGeometry, FloatArray, Scanner, Theta
from worker.tomography.image_grid import ImageGrid
from worker.tomography.iterative.penalised import Objective, Prior, descend, mean_along_rays
from worker.tomography.log_model import LogModel
from worker.tomography.phantom import Disc, Phantom, Polygon, Shape
from worker.tomography.projector import Image, Projector
from worker.tomography.quality import edge_error_mm, relative_error, structural_similarity_index
from worker.tomography.simulate import simulate_sinogram
from worker.tomography.total_variation import total_variation

VIEWS = (17, 20, 24, 30, 45, 60, 90)
SIGMA_FACTORS = np.geomspace(0.4, 1.4, 4)
BETA_FACTORS = np.geomspace(0.35, 2.8, 4)
FIELD_MM = 400.0


def ellipse(x: float, y: float, long_mm: float, short_mm: float, turn: float, density: float) -> Polygon:
    """A polygon of 60 corners."""
    t = np.linspace(0.0, TAU, 61)[:-1]
    a, b = long_mm * np.cos(t), short_mm * np.sin(t)
    c, s = math.cos(turn), math.sin(turn)
    corners = zip(x + c * a - s * b, y + s * a + c * b, strict=True)
    return Polygon(tuple((float(p), float(q)) for p, q in corners), density)


def zoned_log(rng: np.random.Generator) -> Phantom:
    """Broad zones of unlike density, two or three knots or rotten places, perhaps a metal fragment."""
    radius = rng.uniform(100.0, 165.0)
    shapes: list[Shape] = [ellipse(0.0, 0.0, radius, rng.uniform(0.85, 1.0) * radius, rng.uniform(0.0, TAU), 0.018)]
    pith = rng.uniform(-0.08, 0.08, 2) * radius
    shares = np.sort(rng.uniform(0.15, 0.85, rng.integers(3, 8)))[::-1]
    shapes += [Disc((float(pith[0]), float(pith[1])), s * radius, rng.uniform(-0.004, 0.004)) for s in shares]
    for _ in range(rng.integers(2, 4)):
        at, turn = rng.uniform(0.3, 0.65) * radius, rng.uniform(0.0, TAU)
        size = rng.uniform(15.0, 35.0), rng.uniform(6.0, 14.0)
        shapes.append(ellipse(at * math.cos(turn), at * math.sin(turn), *size, turn, rng.uniform(-0.008, 0.008)))
    if rng.uniform() < 0.6:
        at, turn = rng.uniform(0.2, 0.7) * radius, rng.uniform(0.0, TAU)
        metal = (at * math.cos(turn), at * math.sin(turn))
        shapes.append(Disc(metal, rng.uniform(2.5, 12.0), rng.uniform(0.02, 0.1)))
    return Phantom("zoned log", tuple(shapes))


def random_log(rng: np.random.Generator) -> Phantom:
    """One log of either kind, in a unit of its own."""
    if rng.uniform() < 0.5:
        model = LogModel.random(int(rng.integers(1000)), radius_mm=rng.uniform(100.0, 165.0))
        log = model.slice_at(rng.uniform(150.0, 250.0))
    else:
        log = zoned_log(rng)
    return log.of_density(float(rng.choice([1.0, 5.0, 30.0])))


def random_geometry(rng: np.random.Generator, views: int, cells: int) -> FanBeamGeometry:
    """A scanner whose detector sees the whole log; every third at irregular angles."""
    theta = Theta(
        rng.uniform(0.0, TAU), rng.uniform(550.0, 800.0), rng.uniform(-250.0, 250.0), rng.uniform(-60.0, 60.0), 0.0
    )
    tilt = math.tan(math.atan2(theta.source_shift_mm, 900.0) + rng.uniform(-0.15, 0.15))
    theta = Theta(*theta.to_vector()[:4], tilt)
    frame = theta.source_frame(900.0)
    # The cells are shared out over the shadow of the field's middle, wherever the shifts put it.
    pitch = 2.0 * (abs(frame.cor_column_mm) + 190.0 * frame.magnification) / cells
    angles = (np.arange(views) + rng.uniform()) * TAU / views
    if rng.uniform() < 1.0 / 3.0:
        angles = angles + rng.uniform(-0.4, 0.4, views) * TAU / views
    return FanBeamGeometry(Scanner(900.0, cells, float(pitch)), theta, angles)


def best_of_grid(
    projector: Projector, sinogram: FloatArray, noise: float, beta: float, truth: Image
) -> tuple[float, float, float]:
    """Lowest relative error over the grid, and its factors to the noise and to the rule's beta."""
    sigmas, betas = (grid.ravel() for grid in np.meshgrid(SIGMA_FACTORS, BETA_FACTORS))
    lines = projector.block(sinogram)
    weights = np.broadcast_to(1.0 / (noise * sigmas[:, None, None]) ** 2, (16, *lines.shape[1:])).astype(np.float32)
    prior = Prior("cauchy", beta * betas, np.full(16, STRENGTH), beta * betas)
    start = np.repeat(mean_along_rays(projector, lines), 16, axis=0)
    found = descend(
        Objective(projector, lines, weights, prior), start, non_negative=True, iterations=200, tolerance=2e-4
    )
    errors = [relative_error(image, truth) for image in found.images]
    best = int(np.argmin(errors))
    return errors[best], float(sigmas[best]), float(betas[best])


def scores(image: Image, truth: Image) -> str:
    """Relative error, edge error in mm, SSIM."""
    edges = edge_error_mm(image, truth, FIELD_MM / len(truth))
    return f"{relative_error(image, truth):.4f} {edges:.2f} {structural_similarity_index(image, truth):.3f}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=int, default=12)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--seed", type=int, default=400)
    options = parser.parse_args()
    print(
        "log  views  noise  rule   best   ratio  factor of sigma: rule, best  beta: best/rule  misfit  seconds  "
        "error, edge mm, SSIM: rule, TV"
    )
    ratios = []
    for index in range(options.logs):
        rng = np.random.default_rng(options.seed + index)
        views, noise = VIEWS[index % len(VIEWS)], rng.uniform(0.01, 0.04)
        log, geometry = random_log(rng), random_geometry(rng, views, 3 * options.size)
        projector = Projector(geometry, ImageGrid(options.size, FIELD_MM))
        sinogram = simulate_sinogram(log, geometry, noise=noise, seed=index)
        truth = log.rasterise(options.size, FIELD_MM)
        started = time.perf_counter()
        chosen = cauchy_map(projector, sinogram)
        seconds = time.perf_counter() - started
        yardstick = total_variation(projector, sinogram)
        rule = relative_error(chosen.image, truth)
        best, sigma, beta = best_of_grid(projector, sinogram, chosen.noise, float(chosen.beta[0]), truth)
        ratios.append(rule / min(best, rule))
        print(
            f"{index:3d}  {views:5d}  {noise:.3f}  {rule:.4f} {best:.4f} {ratios[-1]:.3f}  "
            f"{chosen.sigma / chosen.noise:.2f} {sigma:.2f}  {beta:.2f}  {chosen.misfit[0]:.2f}  {seconds:.2f}  "
            f"{scores(chosen.image, truth)}  {scores(yardstick.image, truth)}",
            flush=True,
        )
    print(f"largest ratio {max(ratios):.3f}, within 3 %: {sum(ratio <= 1.03 for ratio in ratios)} of {len(ratios)}")


if __name__ == "__main__":
    main()
