"""Speed of the Cauchy MAP against SciPy's L-BFGS-B on ASTRA's CPU projector, and against other descents on ours.

256 x 256 from 20 views of the published log where it is found (see SAWMILL_PUBLISHED_DATA), of a simulated one
elsewhere; sigma and beta given. The best objective known is the lowest that any of the runs reached: the density has
many minima close together, and solvers end in different ones. Prints

- our descent as `cauchy_map` ends it, for one slice and for a block of 16 unlike ones (a simulated log at 16 heights,
  each against the lowest objective of a far longer descent), and SciPy's seconds to within 1e-4 of its own end;
- on one projector, from one start, seconds and projections to within 1e-4 of the best objective known: our
  quasi-Newton descent and the majorise-minimise rivals of majorising.py.

    python benchmarks/iterative.py [--peer-iterations 300] [--repeats 5]
"""

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path

import astra
import numpy as np
from majorising import Counted, Tracked, memory_gradient, reweighted
from scanners import SCANNER
from scipy.optimize import minimize

from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, FloatArray, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_tomography.reconstruction.cauchy_map import STRENGTH, cauchy_map
from sawmill_tomography.reconstruction.iterative.descent import Floats, Images, Indices, minimise
from sawmill_tomography.reconstruction.iterative.first_image import mean_along_rays
from sawmill_tomography.reconstruction.iterative.penalised import (
    CONTINUATION_FACTOR,
    CONTINUATION_ITERATIONS,
    InverseCurvature,
    Objective,
    continuation,
)
from sawmill_tomography.reconstruction.iterative.priors import CauchyPrior

THETA = Theta(2.55023549, 714.683839, 319.943788, 43.6514375, 0.280799451)
VIEWS, SIZE, FIELD_MM, BLOCK = 20, 256, 400.0, 16
WITHIN = 1e-4
# Shares of the sinogram's RMS and of the wood: near the best for either log.
SIGMA_SHARE, BETA_SHARE = 0.013, 0.3
# Settings of the longer descents that show how low the minima are.
LONG = {"iterations": 400, "tolerance": 1e-9}
Track = list[tuple[float, float]]


def scan() -> tuple[str, FanBeamGeometry, FloatArray]:
    """Return name, geometry, sinogram (views, detector)."""
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
        volumes = astra.create_vol_geom(self.grid.size, self.grid.size, -half, half, -half, half)
        _, cells = self.geometry.sinogram_shape
        rays = astra.create_proj_geom("fanflat_vec", cells, self.geometry.astra_vectors())
        object.__setattr__(self, "operator", astra.OpTomo(astra.create_projector("line_fanflat", rays, volumes)))

    def forward(self, image: Images) -> Images:
        """Project an image like our projector."""
        return self.operator.FP(image[0])[None]

    def adjoint(self, sinogram: Images) -> Images:
        """Back-project a sinogram like our projector."""
        return self.operator.BP(sinogram[0])[None]


def tracked(call: Callable[[Images, Indices], tuple[Floats, Images]], track: Track, started: float) -> Callable:
    """Wrap the objective so that (seconds, value) of each call is recorded."""

    def evaluate(vector: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = call(vector.reshape(1, SIZE, SIZE).astype(np.float32), np.array([0]))
        track.append((time.perf_counter() - started, float(value[0])))
        return float(value[0]), gradient.ravel().astype(np.float64)

    return evaluate


def peer(objective: Objective, start: Images, iterations: int) -> Track:
    """Run SciPy's L-BFGS-B with the same continuation; record the values of the objective itself."""
    started = time.perf_counter()
    x, track = start.ravel().astype(np.float64), []
    for factor in (CONTINUATION_FACTOR, 1.0):
        last = factor == 1.0
        prior = objective.prior.rescaled(factor)
        call = Objective(objective.projector, objective.lines, objective.weights, prior)
        found = minimize(
            tracked(call, track if last else [], started),
            x,
            jac=True,
            method="L-BFGS-B",
            bounds=[(0.0, None)] * x.size,
            options={
                "maxiter": iterations if last else CONTINUATION_ITERATIONS,
                "maxcor": 6,
                "ftol": 1e-10,
                "gtol": 0.0,
            },
        )
        x = found.x
    return track


def seconds_to(track: Track, level: float) -> float:
    """Return the time at which the level was first reached."""
    return next(seconds for seconds, value in track if value <= level)


def settings_of(projector: Projector, lines: Images) -> dict[str, float]:
    """Return sigma and beta near the best for such logs."""
    wood = np.quantile(mean_along_rays(projector, lines), 0.75, axis=(1, 2))
    return {"sigma": SIGMA_SHARE * float(np.sqrt(np.mean(lines**2))), "beta": BETA_SHARE * float(np.median(wood))}


def unlike_slices(projector: Projector) -> Images:
    """Simulate a log at 16 heights, with noise."""
    log = LogModel.random(5)
    slices = [
        simulate_sinogram(log.slice_at(100.0 + 50.0 * n), projector.geometry, noise=0.02, seed=n) for n in range(BLOCK)
    ]
    return projector.block(np.stack(slices))


def quasi_newton(objective: Objective, start: Images) -> Tracked:
    """Run our descent with the prior itself, tracked."""
    call, preconditioner = Tracked(objective), InverseCurvature(objective)
    minimise(call, start, lower=0.0, **LONG, preconditioner=preconditioner)
    return call


# The iterations of each suffice to see where it slows down.
RIVALS: dict[str, Callable[[Objective, Images], Tracked]] = {
    "quasi-Newton, 6 steps": quasi_newton,
    "memory gradient, 1 step": lambda o, x: memory_gradient(o, x, iterations=120, memory=1),
    "memory gradient, 6 steps": lambda o, x: memory_gradient(o, x, iterations=120, memory=6),
    "reweighted, 3 conjugate gradients": lambda o, x: reweighted(o, x, iterations=50, inner=3),
    "reweighted, 6 conjugate gradients": lambda o, x: reweighted(o, x, iterations=30, inner=6),
    "reweighted, 15 conjugate gradients": lambda o, x: reweighted(o, x, iterations=15, inner=15),
}


def compare(objective: Objective, start: Images) -> dict[str, Tracked]:
    """Run each rival from the image of the continuation."""
    near = continuation(objective, start, non_negative=True, tolerance=LONG["tolerance"])
    found = {}
    for label, rival in RIVALS.items():
        counted = Counted(objective.projector.geometry, objective.projector.grid)
        found[label] = rival(Objective(counted, objective.lines, objective.weights, objective.prior), near)
    return found


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peer-iterations", type=int, default=300)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    name, geometry, sinogram = scan()
    ours = Projector(geometry, ImageGrid(SIZE, FIELD_MM))
    lines, block = ours.block(sinogram), unlike_slices(ours)
    settings, block_settings = settings_of(ours, lines), settings_of(ours, block)
    cauchy_map(ours, sinogram, **settings, iterations=2)
    laps: dict[str, list[float]] = {"one slice": [], "block": []}
    least = cauchy_map(ours, block, **block_settings, **LONG).objective
    for _ in range(options.repeats):
        started = time.perf_counter()
        one = cauchy_map(ours, sinogram, **settings)
        middle = time.perf_counter()
        many = cauchy_map(ours, block, **block_settings)
        laps["one slice"].append(middle - started)
        laps["block"].append((time.perf_counter() - middle) / BLOCK)
    sigma, beta = settings["sigma"], settings["beta"]
    prior = CauchyPrior(np.array([beta]), np.array([STRENGTH]), np.array([beta]))
    weights = np.full(lines.shape, 1.0 / sigma**2, np.float32)
    start = mean_along_rays(ours, lines)
    rivals = compare(Objective(ours, lines, weights, prior), start)
    theirs = AstraProjector(geometry, ImageGrid(SIZE, FIELD_MM))
    track = peer(Objective(theirs, lines, weights, prior), start, options.peer_iterations)
    reached = float(one.objective[0])
    lowest = {label: min(value for *_, value in found.track) for label, found in rivals.items()}
    best = min(reached, *(value for _, value in track), *lowest.values())
    print(
        f"{name}, {VIEWS} views, {SIZE} x {SIZE}, sigma {sigma:.3g}, beta {beta:.3g}; best objective known {best:.1f}"
    )
    print(
        f"  one slice: {np.median(laps['one slice']):.3f} s (least {min(laps['one slice']):.3f}), "
        f"{reached / best - 1.0:.1e} above the best, {int(one.iterations[0])} iterations"
    )
    above = np.maximum(many.objective / np.minimum(least, many.objective) - 1.0, 0.0)
    print(
        f"  block of {BLOCK}: {np.median(laps['block']):.3f} s a slice (least {min(laps['block']):.3f}), "
        f"{np.median(above):.1e} above each slice's best in the median, {above.max():.1e} at most, "
        f"{many.iterations.min()} to {many.iterations.max()} iterations"
    )
    # SciPy mostly ends in another minimum: its time is measured to its own minimum.
    their_lowest = min(value for _, value in track)
    peer_seconds = seconds_to(track, their_lowest * (1.0 + WITHIN))
    print(
        f"  SciPy L-BFGS-B on ASTRA: {peer_seconds:.3f} s to within {WITHIN:.0e} of its own lowest, which is "
        f"{their_lowest / best - 1.0:.1e} above the best; {track[-1][0]:.3f} s and {len(track)} evaluations in all"
    )
    print("  ratio: " + ", ".join(f"{label} {peer_seconds / np.median(lap):.1f}" for label, lap in laps.items()))
    print("On our projector, from the image of the continuation:")
    print(f"  {'':35s}{'to 1e-3':>20s}{'to 1e-4':>20s}{'lowest, above the best':>25s}")
    for label, found in rivals.items():
        cells = [arrival(found, best * (1.0 + within)) for within in (10.0 * WITHIN, WITHIN)]
        print(f"  {label:35s}{cells[0]:>20s}{cells[1]:>20s}{lowest[label] / best - 1.0:25.1e}")


def arrival(found: Tracked, level: float) -> str:
    """Format seconds and projections until the level."""
    return next((f"{seconds:.3f} s, {used:4d}" for seconds, used, value in found.track if value <= level), "never")


if __name__ == "__main__":
    main()
