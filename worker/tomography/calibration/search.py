"""Where the valley is: differential evolution in the source frame on a coarse, normalised sinogram misfit.

The first angle is not searched: for each candidate (R, ln M, u_c, tau) the phantom is projected once at a table of
turns, and the turn that correlates best with all views is looked up, for each sense of rotation. Gain and background
drop out of the correlation. best/1/bin with crossover 0.7 as in arXiv 2206.14444.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from scipy.optimize import Bounds, differential_evolution

from worker.tomography import analytic
from worker.tomography.analytic import DetectorCells
from worker.tomography.calibration._search_numba import best_turn
from worker.tomography.geometry import (
    TAU,
    FloatArray,
    GeometryError,
    Handedness,
    Rotation,
    Scanner,
    SourceFrame,
    Theta,
    ThetaBounds,
)
from worker.tomography.phantom import Phantom

TURNS = 120
COARSE_VIEWS = 40
COARSE_CELLS = 64
POPULATION = 10
MAX_GENERATIONS = 30
# Spread of 1 - correlation over the population at which the valley is found; refinement does the rest.
SPREAD = 2e-4

# Without bounds: source shifts up to 0.6 r_S, and whatever magnification and tilt a scanner may have.
WIDEST_SHIFT = math.hypot(1.0, 0.6)
MAGNIFICATIONS = (1.02, 6.0)
WIDEST_TILT = 1.2

Progress = Callable[[int, int, float], None]


@dataclass(frozen=True)
class Candidate:
    """A geometry under one of the four hypotheses, and how badly it correlates (1 - correlation)."""

    misfit: float
    frame: SourceFrame


@dataclass
class CoarseMisfit:
    """1 - correlation of a coarse sinogram with the phantom's projection, the first angle looked up.

    Remembers the best candidate of each hypothesis that it has ever seen.
    """

    phantoms: dict[Handedness, Phantom]
    rotations: tuple[Rotation, ...]
    sinogram: FloatArray
    angles_rad: FloatArray
    cells: DetectorCells
    best: dict[tuple[Handedness, Rotation], Candidate] = field(default_factory=dict)
    evaluations: int = 0

    def __post_init__(self) -> None:
        """Prepare what no candidate changes."""
        self._table_rad = np.arange(TURNS) * TAU / TURNS
        self._first = np.round(self.angles_rad * TURNS / TAU).astype(np.int64) % TURNS
        self._sum = float(self.sinogram.sum())
        self._square = float((self.sinogram**2).sum())
        self._signs = np.array([1 if rotation is Rotation.AS_GIVEN else -1 for rotation in self.rotations])
        self._correlation = np.empty(len(self.rotations))
        self._turn = np.empty(len(self.rotations), np.int64)

    def __call__(self, vector: FloatArray) -> float:
        """Least misfit over the hypotheses at (R, ln M, u_c, tau)."""
        r, log_magnification, u_c, tau = (float(value) for value in vector)
        sdd = r * math.exp(log_magnification)
        self.evaluations += 1
        least = 2.0
        for handedness, phantom in self.phantoms.items():
            frame = SourceFrame(0.0, r, sdd, u_c, tau)
            if not analytic.clears(phantom.radius_mm, frame):
                continue
            model = analytic.project(phantom, self.cells, frame, self._table_rad)
            best_turn(
                model, self.sinogram, self._first, self._signs, self._sum, self._square, self._correlation, self._turn
            )
            for index, rotation in enumerate(self.rotations):
                misfit = 1.0 - float(self._correlation[index])
                least = min(least, misfit)
                psi = float(self._turn[index]) * TAU / TURNS
                found = Candidate(misfit, SourceFrame(psi, r, sdd, u_c, tau))
                self._remember((handedness, rotation), found)
        return least

    def _remember(self, hypothesis: tuple[Handedness, Rotation], found: Candidate) -> None:
        kept = self.best.get(hypothesis)
        if kept is None or found.misfit < kept.misfit:
            self.best[hypothesis] = found


def coarse_data(
    scanner: Scanner, sinogram: FloatArray, angles_rad: FloatArray
) -> tuple[FloatArray, FloatArray, DetectorCells]:
    """Every so many views, and cells averaged, down to about 60 x 96: (sinogram, angles, cells)."""
    binned = max(1, scanner.num_detector_pixels // COARSE_CELLS)
    cells = DetectorCells.of(scanner, binned=binned)
    step = max(1, sinogram.shape[0] // COARSE_VIEWS)
    rows = sinogram[::step, : cells.count * binned]
    return rows.reshape(rows.shape[0], cells.count, binned).mean(axis=2), angles_rad[::step], cells


def search_box(scanner: Scanner, bounds: ThetaBounds | None, phantom: Phantom) -> FloatArray:
    """Ranges of (R, ln M, u_c, tau), (4, 2): those that the bounds of theta allow, or wherever a scanner can be.

    Raises
    ------
    GeometryError
        If no geometry inside the bounds shows the centre of rotation on the detector.
    """
    half = 0.5 * scanner.num_detector_pixels * scanner.detector_pitch_mm
    r_s = scanner.source_to_cor_mm
    if bounds is None:
        return np.array([(r_s, WIDEST_SHIFT * r_s), np.log(MAGNIFICATIONS), (-half, half), (-WIDEST_TILT, WIDEST_TILT)])
    rows = []
    grid = [np.linspace(low, high, 13) for low, high in bounds.as_array()[1:]]
    for vector in product(*grid):
        try:
            frame = Theta.from_vector((0.0, *vector)).source_frame(r_s)
        except GeometryError:  # a corner of the box that no scanner can be in
            continue
        if abs(frame.cor_column_mm) < half and analytic.clears(phantom.radius_mm, frame):
            rows.append((frame.source_distance_mm, math.log(frame.magnification), frame.cor_column_mm, frame.tilt_rad))
    if not rows:
        raise GeometryError(
            "no geometry inside the bounds puts the centre of rotation on the detector: check bounds, "
            "source_to_cor_mm, num_detector_pixels and detector_pitch_mm"
        )
    box = np.array(rows)
    return np.stack([box.min(axis=0), box.max(axis=0)], -1)


@dataclass(frozen=True)
class SearchOutcome:
    """The best candidate of each hypothesis, and how the search went."""

    best: dict[tuple[Handedness, Rotation], Candidate]
    evaluations: int
    generations: int
    best_value: float
    converged: bool
    message: str


def search(misfit: CoarseMisfit, box: FloatArray, *, seed: int, progress: Progress | None = None) -> SearchOutcome:
    """Differential evolution of (R, ln M, u_c, tau) inside the box."""

    def report(intermediate_result: object) -> None:
        if progress is not None:
            progress(
                getattr(intermediate_result, "nit", 0), MAX_GENERATIONS, getattr(intermediate_result, "fun", math.nan)
            )

    outcome = differential_evolution(
        misfit,
        Bounds(box[:, 0], box[:, 1]),
        strategy="best1bin",
        recombination=0.7,
        mutation=(0.5, 1.0),
        popsize=POPULATION,
        maxiter=MAX_GENERATIONS,
        tol=0.0,
        atol=SPREAD,
        polish=False,
        init="sobol",
        rng=np.random.default_rng(seed),
        callback=report,
    )
    return SearchOutcome(
        best=misfit.best,
        evaluations=misfit.evaluations,
        generations=int(outcome.nit),
        best_value=float(outcome.fun),
        converged=bool(outcome.success),
        message=str(outcome.message),
    )
