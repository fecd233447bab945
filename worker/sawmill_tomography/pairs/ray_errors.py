"""The distance between the rays of two geometries of fixed pairs, up to a common rigid motion and a common scale."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sawmill_tomography.geometry.detector_shape import cell_points
from sawmill_tomography.geometry.geometry import FloatArray, GeometryError, SourceFrame, rotate
from sawmill_tomography.pairs.passages import moved_frames
from sawmill_tomography.statistics import exceeded_chi_square
from sawmill_vocabulary import Scanner

# Rays of a pair that are compared, and the two points of Gauss on each chord, which are exact for a line's square.
RAYS, GAUSS = 40, 1.0 / math.sqrt(3.0)
# Steps by which rays are differentiated: rad, mm, mm, mm, rad.
STEPS = np.array([1e-5, 1e-2, 1e-2, 1e-2, 1e-5])
PROMISED = 0.95


@dataclass(frozen=True)
class PredictedRays:
    """What a covariance predicts of the ray error."""

    rms_mm: float
    upper_95_mm: float  # the RMS that the error exceeds in 5 % of calibrations


@dataclass(frozen=True, eq=False)
class PairRays:
    """Rays of all pairs inside the disc about the origin in which errors count.

    Attributes
    ----------
    scanners : sequence of Scanner
        The constants of each pair.
    frames : (pairs, 5) float64
        The geometry of each pair, rows (psi, R, SDD, u_c, tau), mm and rad.
    radius_mm : float
        Radius of the disc.
    """

    scanners: Sequence[Scanner]
    frames: FloatArray
    radius_mm: float

    @cached_property
    def cells(self) -> list[FloatArray]:
        """Cells of each pair that are compared: about 40 of those whose rays meet the disc."""
        chosen = []
        for number, (scanner, frame) in enumerate(zip(self.scanners, self.frames, strict=True)):
            source, angle = _rays(scanner, frame)
            inside = np.flatnonzero(np.abs(-np.sin(angle) * source[0] + np.cos(angle) * source[1]) < self.radius_mm)
            if inside.size < 2:
                raise GeometryError(
                    f"no ray of pair {number + 1} meets the disc of radius {self.radius_mm:.4g} mm about the centre"
                )
            chosen.append(inside[np.linspace(0, inside.size - 1, min(RAYS, inside.size)).round().astype(int)])
        return chosen

    @cached_property
    def points(self) -> FloatArray:
        """Points on the chords, (points, 2) mm, pair by pair."""
        places = []
        for scanner, frame, cells in zip(self.scanners, self.frames, self.cells, strict=True):
            source, angle = _rays(scanner, frame)
            direction = np.stack([np.cos(angle), np.sin(angle)], -1)[cells]
            along = -(direction @ source)
            half = np.sqrt(np.maximum(self.radius_mm**2 - (source @ source - along**2), 0.0))
            at = along[:, None] + half[:, None] * np.array([-GAUSS, GAUSS])
            places.append((source + at[..., None] * direction[:, None]).reshape(-1, 2))
        return np.concatenate(places)

    @cached_property
    def of_pair(self) -> FloatArray:
        """The number of each point's pair, (points,)."""
        return np.repeat(np.arange(len(self.frames)), [2 * cells.size for cells in self.cells])

    def distances(self, frames: FloatArray) -> FloatArray:
        """Return by how much the rays of other frames miss the points, (points,) mm, signed."""
        normals, sources = self._lines(frames)
        return np.asarray(np.einsum("pc,pc->p", normals, sources - self.points))

    def _lines(self, frames: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the normal of the ray to each point's cell, and the ray's source, (points, 2) both."""
        normals, sources = [], []
        for scanner, frame, cells in zip(self.scanners, frames, self.cells, strict=True):
            source, angle = _rays(scanner, frame)
            normals.append(np.repeat(np.stack([-np.sin(angle), np.cos(angle)], -1)[cells], 2, axis=0))
            sources.append(np.broadcast_to(source, normals[-1].shape))
        return np.concatenate(normals), np.concatenate(sources)

    @cached_property
    def gauge(self) -> FloatArray:
        """Change of the distances by a shift along x and y, a turn, and a common scale, (points, 4)."""
        n, s = self._lines(self.frames)
        turned = n[:, 1] * self.points[:, 0] - n[:, 0] * self.points[:, 1]
        return np.column_stack([n, turned, np.einsum("pc,pc->p", n, s)])

    @cached_property
    def slopes(self) -> FloatArray:
        """Derivatives of the distances by the frames, (points, 5 pairs)."""
        return _slopes(self.distances, self.frames, np.tile(STEPS, len(self.frames)))

    @cached_property
    def to_gauge(self) -> FloatArray:
        """The rigid motion and scale that a change of the frames contains, (4, 5 pairs)."""
        return np.asarray(np.linalg.lstsq(self.gauge, self.slopes)[0], np.float64)

    def predicted(self, covariance: FloatArray, pair: int | None = None) -> PredictedRays:
        """Predict the ray error of all pairs, or of one, from the covariance (5 pairs, 5 pairs) of the frames.

        The upper bound comes from the scaled chi-square with the same mean and variance (Satterthwaite 1946).
        """
        left = self.slopes - self.gauge @ self.to_gauge
        left = left if pair is None else left[self.of_pair == pair]
        square = left.T @ left / len(left) @ covariance
        mean, spread = float(np.trace(square)), float(np.trace(square @ square))
        freedom = mean**2 / spread
        return PredictedRays(math.sqrt(mean), math.sqrt(mean * exceeded_chi_square(1.0 - PROMISED, freedom) / freedom))

    def without_motion(self, covariance: FloatArray, motion: FloatArray, frames: FloatArray) -> FloatArray:
        """Return the covariance (5 pairs, 5 pairs) of these frames after a motion, without what moves all alike.

        `covariance` belongs to `frames` (pairs, 5) before the motion (3,).
        """
        moved = _slopes(lambda x: moved_frames(x, motion.tolist()), frames, np.tile(STEPS, len(frames)))
        rigid = _slopes(lambda x: moved_frames(self.frames, x.tolist()), np.zeros(3), STEPS[[1, 2, 0]])
        kept = (np.eye(frames.size) - rigid @ self.to_gauge[:3]) @ moved
        return kept @ covariance @ kept.T

    def scale_deviation(self, covariance: FloatArray) -> float:
        """Predict the standard deviation of the common scale, a share."""
        row = self.to_gauge[3]
        return math.sqrt(max(float(row @ covariance @ row), 0.0))


def _slopes(of: Callable[[FloatArray], FloatArray], at: FloatArray, steps: FloatArray) -> FloatArray:
    """Return the derivatives of a function's values, as one list, by its n numbers, (values, n)."""
    ends = [[of(at + way.reshape(at.shape)).ravel() for way in np.diag(sign * steps)] for sign in (1.0, -1.0)]
    return np.asarray((np.stack(ends[0], -1) - np.stack(ends[1], -1)) / (2.0 * steps))


def rigid_motion(true: PairRays, frames: FloatArray) -> FloatArray:
    """Return the motion (3,), x and y in mm and a turn in rad, that brings other frames nearest to the rays."""
    # The first one turns the sources as far as they are turned in the mean.
    motion = np.array([0.0, 0.0, float(np.angle(np.exp(1j * (true.frames[:, 0] - frames[:, 0])).sum()))])
    for _ in range(50):
        step = np.linalg.lstsq(true.gauge[:, :3], -true.distances(moved_frames(frames, motion.tolist())))[0]
        # The step turns about the origin after what was moved before.
        motion = np.add(step, [*rotate(step[2], *motion[:2]), motion[2]])
        if np.abs(step).max() < 1e-12:
            break
    return motion


def _rays(scanner: Scanner, frame: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the source (2,), and the angle of the ray to each cell (cells,)."""
    psi, r = frame[:2]
    across, along = cell_points(scanner, SourceFrame.from_vector(frame)).T
    return np.array([r * math.sin(psi), -r * math.cos(psi)]), psi + np.arctan2(along, across)
