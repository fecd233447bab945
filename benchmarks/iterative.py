"""Speed of the Cauchy MAP against SciPy's L-BFGS-B on ASTRA's CPU projector: same objective, same data, one run.

256 x 256 from 20 views of the published log where it is found (see SAWMILL_PUBLISHED_DATA), of a simulated one
elsewhere; sigma and beta given. The best objective known is the lowest that any of the runs reached. Prints, for our
descent (one slice, and a slice of a block of 16) and for SciPy: seconds to within 1e-4 of it, and in all.

    python benchmarks/iterative.py [--peer-iterations 300] [--repeats 5]
"""

import argparse
import math
import os
import time
from collections.abc import Callable
from pathlib import Path

import astra
import numpy as np
from scanners import SCANNER
from scipy.optimize import minimize

from worker.tomography.cauchy_map import STRENGTH, cauchy_map
from worker.tomography.geometry import TAU, FanBeamGeometry, FloatArray, Theta
from worker.tomography.image_grid import ImageGrid
from worker.tomography.iterative.descent import Floats, Images, Indices
from worker.tomography.iterative.penalised import FACTORS, WIDE_ITERATIONS, Objective, Prior, mean_along_rays
from worker.tomography.log_model import LogModel
from worker.tomography.projector import Projector
from worker.tomography.simulate import simulate_sinogram

THETA = Theta(2.55023549, 714.683839, 319.943788, 43.6514375, 0.280799451)
VIEWS, SIZE, FIELD_MM, BLOCK = 20, 256, 400.0, 16
WITHIN = 1e-4
# Shares of the sinogram's RMS and of the wood: near the best for either log.
SIGMA_SHARE, BETA_SHARE = 0.013, 0.3
Track = list[tuple[float, float]]


def scan() -> tuple[str, FanBeamGeometry, FloatArray]:
    """Name, geometry, sinogram (views, detector)."""
    step = 360 // VIEWS
    geometry = FanBeamGeometry(SCANNER, THETA, ((np.arange(360) + 0.5) * TAU / 360)[::step])
    path = Path(os.environ.get("SAWMILL_PUBLISHED_DATA", "../shared/data")) / "log-phantom" / "sinogram.npy"
    if path.is_file():
        return "published log", geometry, np.load(path, allow_pickle=False)[::step]
    log = LogModel.random(5).slice_at(200.0)
    return "simulated log", geometry, simulate_sinogram(log, geometry, noise=0.02, seed=5)


class AstraProjector(Projector):
    """The same A with ASTRA's CPU kernels, in float32."""

    def __post_init__(self) -> None:
        """Make ASTRA's operator."""
        half = 0.5 * self.grid.field_mm
        volume = astra.create_vol_geom(self.grid.size, self.grid.size, -half, half, -half, half)
        cells = self.geometry.scanner.num_detector_pixels
        rays = astra.create_proj_geom("fanflat_vec", cells, self.geometry.astra_vectors())
        object.__setattr__(self, "operator", astra.OpTomo(astra.create_projector("line_fanflat", rays, volume)))

    def forward(self, image: Images) -> Images:
        """As ours."""
        return self.operator.FP(image[0])[None]

    def adjoint(self, sinogram: Images) -> Images:
        """As ours."""
        return self.operator.BP(sinogram[0])[None]


def tracked(call: Callable[[Images, Indices], tuple[Floats, Images]], track: Track, started: float) -> Callable:
    """The objective, writing down (seconds, value) of each call."""

    def evaluate(vector: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = call(vector.reshape(1, SIZE, SIZE).astype(np.float32), np.array([0]))
        track.append((time.perf_counter() - started, float(value[0])))
        return float(value[0]), gradient.ravel().astype(np.float64)

    return evaluate


def peer(objective: Objective, start: Images, iterations: int) -> Track:
    """SciPy's L-BFGS-B through the same widened priors; the sharp prior's values."""
    started = time.perf_counter()
    x, track = start.ravel().astype(np.float64), []
    for factor in FACTORS:
        last = factor == FACTORS[-1]
        prior = objective.prior.widened(factor)
        call = Objective(objective.projector, objective.lines, objective.weights, prior)
        found = minimize(
            tracked(call, track if last else [], started),
            x,
            jac=True,
            method="L-BFGS-B",
            bounds=[(0.0, None)] * x.size,
            options={"maxiter": iterations if last else WIDE_ITERATIONS, "maxcor": 6, "ftol": 1e-10, "gtol": 0.0},
        )
        x = found.x
    return track


def seconds_to(track: Track, level: float) -> float:
    """When the running minimum first reached the level; infinite where never."""
    return next((seconds for seconds, value in track if value <= level), math.inf)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peer-iterations", type=int, default=300)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    name, geometry, sinogram = scan()
    ours = Projector(geometry, ImageGrid(SIZE, FIELD_MM))
    lines = ours.block(sinogram)
    start = mean_along_rays(ours, lines)
    sigma = SIGMA_SHARE * float(np.sqrt(np.mean(lines**2)))
    beta = BETA_SHARE * float(np.quantile(start, 0.75))
    block = np.repeat(lines, BLOCK, axis=0)
    settings = {"sigma": sigma, "beta": beta}
    cauchy_map(ours, sinogram, **settings, iterations=2)
    cauchy_map(ours, block, **settings, iterations=2)
    prior = Prior("cauchy", np.array([beta]), np.array([STRENGTH]), np.array([beta]))
    weights = np.full(lines.shape, 1.0 / sigma**2, np.float32)
    laps: dict[str, list[float]] = {"one slice": [], "block": []}
    for _ in range(options.repeats):
        started = time.perf_counter()
        one = cauchy_map(ours, sinogram, **settings)
        middle = time.perf_counter()
        many = cauchy_map(ours, block, **settings)
        laps["one slice"].append(middle - started)
        laps["block"].append((time.perf_counter() - middle) / BLOCK)
    theirs = AstraProjector(geometry, ImageGrid(SIZE, FIELD_MM))
    track = peer(Objective(theirs, lines, weights, prior), start, options.peer_iterations)
    best = min(float(one.objective[0]), float(many.objective.min()), *(value for _, value in track))
    print(f"{name}, {VIEWS} views, {SIZE} x {SIZE}, sigma {sigma:.3g}, beta {beta:.3g}; best objective {best:.1f}")
    reached = {"one slice": float(one.objective[0]), "block": float(many.objective.max())}
    for label, seconds in laps.items():
        print(
            f"  ours, {label:9s}: {np.median(seconds):7.3f} s a slice (least {min(seconds):.3f}), "
            f"objective {reached[label] / best - 1.0:.1e} above the best, {int(one.iterations[0])} iterations"
        )
    level = max(best * (1.0 + WITHIN), *reached.values())
    peer_seconds = seconds_to(track, level)
    print(f"  SciPy L-BFGS-B on ASTRA: {peer_seconds:7.3f} s to the same, {track[-1][0]:.3f} s in all, ", end="")
    print(f"objective {min(value for _, value in track) / best - 1.0:.1e} above the best, {len(track)} evaluations")
    until = peer_seconds if math.isfinite(peer_seconds) else track[-1][0]
    print("  ratio: " + ", ".join(f"{label} {until / np.median(seconds):.1f}" for label, seconds in laps.items()))


if __name__ == "__main__":
    main()
