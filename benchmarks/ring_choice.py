"""What `ring_tv` takes for rings: boards, squares, discs and the L, which have none, and logs of the model, which have.

Prints the ring weight that is chosen for each, and of logs the error by `ring_tv` as a share of that by
`total_variation`; at the end the number of bodies with rings, of logs without, and the geometric mean of the shares.

    python benchmarks/ring_choice.py [--bodies 170] [--logs 100]
"""

import argparse
import math

import numpy as np

from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, FloatArray, Scanner, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.phantoms.phantom import Disc, Phantom, Polygon
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_tomography.reconstruction.quality import relative_error
from sawmill_tomography.reconstruction.total_variation import ring_tv, total_variation
from sawmill_tomography.reconstruction.total_variation_weights import choose_ring_weight

SEED, FIRST_LOG, WOOD_PER_MM = 1, 500, 0.015
# The field, a log's and the largest disc's radius, half a board's diagonal.
FIELD_MM, LOG_MM, DISC_MM, DIAGONAL_MM = 200.0, 80.0, 88.0, 90.0


def body_without_rings(index: int, rng: np.random.Generator) -> Phantom:
    """Draw a board, every third a square; every fifth is an L, every seventh a disc."""
    width, height = rng.uniform(20.0, 80.0, 2)
    height = width if index % 3 == 0 else height
    width, height = np.array([width, height]) * min(1.0, DIAGONAL_MM / math.hypot(width, height))
    turn, at = float(rng.choice([0.0, rng.uniform(0.0, 1.5)])), rng.uniform(-5.0, 5.0, 2)
    if index % 7 == 6:
        return Phantom("disc", (Disc((float(at[0]), float(at[1])), min(width + 20.0, DISC_MM), WOOD_PER_MM),))
    corners: tuple[tuple[float, float], ...] = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))
    if index % 5 == 4:
        corners = (*corners[:2], (1.0, -0.2), (-0.1, -0.2), (-0.1, 1.0), corners[3])
    board = Polygon(tuple((float(x * width), float(y * height)) for x, y in corners), WOOD_PER_MM)
    return Phantom("board", (board,)).rotated(turn).moved(*at)


def scan_of(body: Phantom, seed: int, rng: np.random.Generator) -> tuple[Projector, FloatArray]:
    """Simulate a scan with random numbers of views, noise and pixels."""
    views, noise, size = int(rng.choice([12, 20, 20, 45])), rng.choice([0.005, 0.01, 0.02]), int(rng.choice([96, 128]))
    scanner = Scanner(860.0, 2 * size, 3.07 * FIELD_MM / (2 * size))
    geometry = FanBeamGeometry(scanner, Theta(0.7, 700.0, 50.0, 10.0, 0.05), (np.arange(views) + 0.5) * TAU / views)
    return Projector(geometry, ImageGrid(size, FIELD_MM)), simulate_sinogram(body, geometry, noise=noise, seed=seed)


def main() -> None:
    """Print each body and log, and the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bodies", type=int, default=170)
    parser.add_argument("--logs", type=int, default=100)
    options = parser.parse_args()
    rings = []
    for index in range(options.bodies):
        rng = np.random.default_rng((SEED, index))
        projector, lines = scan_of(body_without_rings(index, rng), index, rng)
        rings.append(choose_ring_weight(projector, lines).ring_weight)
        print(f"body {index}, {len(lines)} views: ring weight {rings[-1]:g}", flush=True)
    without, shares = 0, []
    for index in range(options.logs):
        rng = np.random.default_rng((SEED + 1, index))
        model = LogModel.random(FIRST_LOG + index, radius_mm=float(rng.uniform(90.0, 160.0)))
        log = model.slice_at(120.0 if index % 2 else 170.0).scaled(LOG_MM / model.radius_mm)
        projector, lines = scan_of(log, index, rng)
        truth, made = log.rasterise(projector.grid.size, FIELD_MM), ring_tv(projector, lines)
        without += int(made.parameters["ring_weight"][0] == 1.0)
        shares.append(
            relative_error(made.image, truth) / relative_error(total_variation(projector, lines).image, truth)
        )
        print(f"log {index}, {len(lines)} views: {made.parameters['ring_weight'][0]:g}, {shares[-1]:.3f}", flush=True)
    found = sum(weight < 1.0 for weight in rings)
    print(f"rings in {found} of {len(rings)} bodies, none in {without} of {len(shares)} logs")
    if shares:
        print(f"error of the logs {np.exp(np.mean(np.log(shares))):.3f} times that by total variation")


if __name__ == "__main__":
    main()
