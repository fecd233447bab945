"""A coarse, normalised sinogram misfit of initial guesses in the source frame.

The first angle is not searched: for each guess (R, ln M, u_c, tau) the phantom is projected once at a table of
turns, and the turn that correlates best with all views is read from the table, for each sense of rotation. Gain and
background drop out of the correlation.

Initial guesses of the geometry: guesses that cast the measured shadow, and random guesses where that is not enough.
Over a full turn the phantom's farthest point sweeps a disc of the phantom's radius, so the shadow of all views
together reaches from -gamma to +gamma with sin gamma = radius / R. For each (R, tau) that fixes SDD and u_c. A few
values of R, along which the basin is long and flat, and of tau remain to be tried.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.calibration.search._search_numba import best_turn
from sawmill_tomography.calibration.sinogram_data import FEW_VIEWS
from sawmill_tomography.calibration.task import PoseHypothesis
from sawmill_tomography.geometry.geometry import (
    TAU,
    FloatArray,
    GeometryError,
    Scanner,
    SourceFrame,
    Theta,
    ThetaBounds,
    bounds_array,
)
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_vocabulary import Handedness, Rotation

TURNS = 120
COARSE_VIEWS = 40
COARSE_CELLS = 64
# Ranges without bounds: source shifts up to 0.6 r_S, and all magnifications that a scanner may have.
WIDEST_SHIFT = math.hypot(1.0, 0.6)
LARGEST_MAGNIFICATION = 10.0


@dataclass(frozen=True)
class Candidate:
    """A geometry under one of the four hypotheses, and the misfit (1 - correlation)."""

    misfit: float
    frame: SourceFrame

    @property
    def relative_residual(self) -> float:
        """Share of the coarse sinogram that the best gain and background leave: sqrt(1 - correlation^2)."""
        return math.sqrt(max(self.misfit * (2.0 - self.misfit), 0.0))


@dataclass
class CoarseMisfit:
    """Objective 1 - correlation of a coarse sinogram with the phantom's projection at the best first angle."""

    phantoms: dict[Handedness, Phantom]
    rotations: tuple[Rotation, ...]
    sinogram: FloatArray
    angles_rad: FloatArray
    cells: DetectorCells
    evaluations: int = 0

    def __post_init__(self) -> None:
        """Prepare the parts that are the same for all candidates."""
        self.table_rad = np.arange(TURNS) * TAU / TURNS
        self._first = self._in_turns([rotation.apply(self.angles_rad) for rotation in self.rotations])
        self._sum = float(self.sinogram.sum())
        self._square = float((self.sinogram**2).sum())

    def __call__(self, vector: FloatArray) -> dict[PoseHypothesis, Candidate]:
        """Evaluate each hypothesis at (R, ln M, u_c, tau) with the best first angle; empty where no scanner can be."""
        return {
            PoseHypothesis(handedness, rotation): candidate
            for handedness, candidates in self._at(vector, self._first).items()
            for rotation, candidate in zip(self.rotations, candidates, strict=True)
        }

    def with_angles(self, vector: FloatArray, choices: FloatArray) -> dict[PoseHypothesis, list[Candidate]]:
        """Evaluate each hypothesis with each choice of the views' angles, (choices, views), rad."""
        first = self._in_turns([rotation.apply(choices) for rotation in self.rotations]).reshape(-1, choices.shape[1])
        return {
            PoseHypothesis(handedness, rotation): candidates[number * len(choices) : (number + 1) * len(choices)]
            for handedness, candidates in self._at(vector, first).items()
            for number, rotation in enumerate(self.rotations)
        }

    @staticmethod
    def _in_turns(angles_rad: Sequence[FloatArray]) -> NDArray[np.int64]:
        return np.round(np.array(angles_rad) * TURNS / TAU).astype(np.int64) % TURNS

    def _at(self, vector: FloatArray, first: NDArray[np.int64]) -> dict[Handedness, list[Candidate]]:
        """Evaluate each handedness with each choice of the views' angles, (choices, views), in turns of the table."""
        r, log_magnification, u_c, tau = (float(value) for value in vector)
        sdd = r * math.exp(log_magnification)
        self.evaluations += 1
        candidates = {}
        correlation, turn = np.empty(len(first)), np.empty(len(first), np.int64)
        for handedness, phantom in self.phantoms.items():
            frame = SourceFrame(0.0, r, sdd, u_c, tau)
            if not analytic.clears(phantom.radius_mm, frame):
                continue
            model = analytic.project(phantom, self.cells, frame, self.table_rad)
            best_turn(model, self.sinogram, first, self._sum, self._square, correlation, turn)
            candidates[handedness] = [
                Candidate(1.0 - value, SourceFrame(where * TAU / TURNS, r, sdd, u_c, tau))
                for value, where in zip(correlation.tolist(), turn.tolist(), strict=True)
            ]
        return candidates


def coarse_data(
    scanner: Scanner, sinogram: FloatArray, angles_rad: FloatArray
) -> tuple[FloatArray, FloatArray, DetectorCells]:
    """Take views at regular intervals and average cells, down to about 40 x 64: (sinogram, angles, cells)."""
    binned = max(1, scanner.num_detector_pixels // COARSE_CELLS)
    cells = DetectorCells.of(scanner, binned=binned)
    step = max(1, sinogram.shape[0] // COARSE_VIEWS)
    rows = sinogram[::step, : cells.count * binned]
    return rows.reshape(rows.shape[0], cells.count, binned).mean(axis=2), angles_rad[::step], cells


def search_box(scanner: Scanner, bounds: ThetaBounds | None, phantom: Phantom) -> FloatArray:
    """Return ranges of (R, ln M, u_c, tau), (4, 2), that the bounds of theta allow, or all possible ones."""
    half = 0.5 * scanner.num_detector_pixels * scanner.detector_pitch_mm
    r_s = scanner.source_to_cor_mm
    if bounds is None:
        magnified = (0.0, math.log(LARGEST_MAGNIFICATION))
        return np.array([(r_s, WIDEST_SHIFT * r_s), magnified, (-half, half), (-WIDEST_TILT, WIDEST_TILT)])
    rows = []
    grid = [np.linspace(low, high, 13) for low, high in bounds_array(bounds)[1:]]
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


DISTANCES, TILTS = 2, 9
# The largest tilt of a guess; least squares may exceed this tilt.
WIDEST_TILT = 1.2
# A cell belongs to the shadow where the strongest of few views reach this share of the deepest shadow.
SHADOW_LEVEL = 0.06


def shadow_extent(sinogram: FloatArray, cells: DetectorCells) -> tuple[float, float] | None:
    """Find where the shadow of all views together begins and ends on the detector, mm; None without a shadow."""
    low, high = np.percentile(sinogram, [2.0, 99.5])
    air = float(np.median(sinogram[sinogram <= low + 0.1 * (high - low)]))
    strongest = max(1, round(FEW_VIEWS * len(sinogram)))
    depth = np.sort(sinogram, axis=0)[-strongest:].mean(axis=0) - air
    covered = np.flatnonzero(depth > SHADOW_LEVEL * (high - air))
    if covered.size == 0:
        return None
    ends = cells.first_border_mm + cells.width_mm * np.array([covered[0], covered[-1] + 1])
    return float(ends[0]), float(ends[1])


def shadow_guesses(
    extent: tuple[float, float], phantom_radius_mm: float, distances: tuple[float, float], rng: np.random.Generator
) -> FloatArray:
    """Return guesses of (R, ln M, u_c, tau), (guesses, 4), for R between `distances`; `rng` shifts the grid."""
    left, right = extent
    shift_r, shift_tau = rng.uniform(0.0, 1.0, 2)
    guesses = []
    for r in distances[0] + (np.arange(DISTANCES) + shift_r) / DISTANCES * (distances[1] - distances[0]):
        gamma = math.asin(min(phantom_radius_mm / r, 0.95))
        for tau in -WIDEST_TILT + (np.arange(TILTS) + shift_tau) / TILTS * 2.0 * WIDEST_TILT:
            if math.cos(gamma + abs(tau)) < 0.05:
                continue
            far = math.sin(gamma) / math.cos(gamma + tau)
            near = -math.sin(gamma) / math.cos(gamma - tau)
            sdd = (right - left) / (far - near)
            if sdd > r:
                guesses.append((r, math.log(sdd / r), right - sdd * far, tau))
    return np.array(guesses, np.float64).reshape(-1, 4)


def random_guesses(box: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """Draw a Latin hypercube of `count` guesses (R, ln M, u_c, tau) in the box (4, 2)."""
    strata = rng.permuted(np.tile(np.arange(count), (4, 1)), axis=1).T
    return np.asarray(box[:, 0] + (strata + rng.uniform(size=(count, 4))) / count * (box[:, 1] - box[:, 0]))
