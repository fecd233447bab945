"""Simulated logs with nails: `NailedLog.random(seed, nail)`, by exact chords of ellipses and rods.

A log is an ellipse of 90 to 140 mm with heartwood, rings in two of three logs, and up to five knots that attenuate 0.4
to 1.5 times the wood more than it. A nail is a rod of steel: in the slice plane a rectangle, across it a disc. Data are
counts: each cell averages the intensity of six rays, 30 000 photons, Poisson noise, ten flats. Nothing is shared with
the projectors, nor with the simulations of the product.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, FloatArray, Scanner, Theta, cell_centres_mm

SCANNER = Scanner(source_to_cor_mm=859.46, num_detector_pixels=768, detector_pitch_mm=1.502864583)
THETA = Theta(0.7, 715.0, 40.0, 10.0, 0.05)
PHOTONS, FLATS, RAYS_PER_CELL, LEAST_TRANSMISSION = 30_000.0, 10, 6, 1e-6
# Points of a pixel along each side, for the truth.
FINE = 5


def views_all_round(views: int) -> FanBeamGeometry:
    """Return the scanner with views all round."""
    return FanBeamGeometry(SCANNER, THETA, (np.arange(views) + 0.5) * TAU / views)


@dataclass(frozen=True)
class Nail:
    """A nail: its diameter, its length in the slice plane (0 across it), and its attenuation as a multiple of wood."""

    diameter_mm: float
    length_mm: float
    times_wood: float


@dataclass(frozen=True)
class Body:
    """An ellipse or a rectangle: its half axes, the direction of the first, and what it adds per mm."""

    centre_mm: tuple[float, float]
    half_mm: tuple[float, float]
    direction_rad: float
    per_mm: float
    is_rod: bool = False

    def own_frame(self, points: FloatArray) -> FloatArray:
        """Turn vectors (..., 2) to the body's axes, in units of the half axes."""
        c, s = math.cos(self.direction_rad), math.sin(self.direction_rad)
        return points @ np.array([[c, -s], [s, c]]) / np.array(self.half_mm)

    def holds(self, points_mm: FloatArray) -> NDArray[np.bool_]:
        """Return which points (..., 2) lie inside."""
        own = self.own_frame(points_mm - np.array(self.centre_mm))
        inside: NDArray[np.bool_] = np.abs(own).max(axis=-1) < 1.0 if self.is_rod else (own**2).sum(axis=-1) < 1.0
        return inside

    def chords_mm(self, sources_mm: FloatArray, directions: FloatArray) -> FloatArray:
        """Return the lengths of rays in the body, from sources (views, 1, 2) along unit vectors (views, rays, 2)."""
        start, along = self.own_frame(sources_mm - np.array(self.centre_mm)), self.own_frame(directions)
        if self.is_rod:
            with np.errstate(divide="ignore"):
                ends = np.stack([(-1.0 - start) / along, (1.0 - start) / along])
            return np.clip(ends.max(axis=0).min(axis=-1) - ends.min(axis=0).max(axis=-1), 0.0, None)
        a, b, c = (along**2).sum(axis=-1), (start * along).sum(axis=-1), (start**2).sum(axis=-1) - 1.0
        return 2.0 * np.sqrt(np.clip(b * b - a * c, 0.0, None)) / a


@dataclass(frozen=True)
class NailedLog:
    """A log with some nails or none."""

    wood: tuple[Body, ...]
    nails: tuple[Body, ...]

    @classmethod
    def random(cls, seed: int, *nails: Nail) -> "NailedLog":
        """Draw a log by the seed, and the places of its nails: the log itself does not depend on the nails."""
        rng = np.random.default_rng(seed)
        radius, aspect, turn = rng.uniform(90.0, 140.0), rng.uniform(0.82, 1.0), rng.uniform(0.0, math.pi)
        centre = tuple(rng.uniform(-10.0, 10.0, 2).tolist())
        per_mm = rng.uniform(1.0, 1.9) / radius
        whole = Body(centre, (radius, aspect * radius), turn, per_mm)
        wood = [whole, _part(whole, rng.uniform(0.4, 0.7), -rng.uniform(0.0, 0.35))]
        for share in np.linspace(0.15, 0.95, 12) if seed % 3 else ():
            contrast, width = rng.uniform(0.05, 0.25), rng.uniform(1.0, 3.0) / radius
            wood += [_part(whole, share, contrast), _part(whole, share - width, -contrast)]
        for _ in range(rng.integers(0, 6)):
            length, thickness = rng.uniform(0.2, 0.4) * radius, rng.uniform(4.0, 15.0)
            place, direction = _place(whole, rng, 0.3, 0.55)
            wood.append(Body(place, (length, thickness), direction, rng.uniform(0.4, 1.5) * per_mm))
        return cls(tuple(wood), tuple(_nail(whole, nail, rng) for nail in nails))

    @property
    def plain(self) -> "NailedLog":
        """The log without its nails."""
        return replace(self, nails=())

    def line_integrals(self, fan: FanBeamGeometry) -> FloatArray:
        """Return the exact line integrals of all rays, (views, cells, rays of a cell)."""
        rays = _rays(fan)
        exact = sum((body.per_mm * body.chords_mm(*rays) for body in (*self.wood, *self.nails)), np.zeros(()))
        return exact.reshape(*fan.sinogram_shape, RAYS_PER_CELL)

    def scan(self, fan: FanBeamGeometry, seed: int, rows: int = 1) -> NDArray[np.float32]:
        """Simulate line integrals (views, rows, cells) of rows with this cross-section."""
        rng = np.random.default_rng(seed)
        intensity = np.exp(-self.line_integrals(fan)).mean(axis=-1)[:, None]
        flats = rng.poisson(PHOTONS, (FLATS, rows, intensity.shape[-1])).mean(axis=0)
        counts = rng.poisson(PHOTONS * np.broadcast_to(intensity, (len(intensity), rows, intensity.shape[-1])))
        return (-np.log(np.maximum(counts / flats, LEAST_TRANSMISSION))).astype(np.float32)

    def truth(self, size: int, field_mm: float) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Return the wood's attenuation per mm as the mean over pixels, and which pixels a nail touches."""
        line = (np.arange(size * FINE) + 0.5) * field_mm / (size * FINE) - 0.5 * field_mm
        points = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1)
        wood, metal = np.zeros(points.shape[:2]), np.zeros(points.shape[:2], bool)
        for body in self.wood:
            wood += body.per_mm * body.holds(points)
        for body in self.nails:
            metal |= body.holds(points)
        pixels = (size, FINE, size, FINE)
        return wood.reshape(pixels).mean(axis=(1, 3)).astype(np.float32), metal.reshape(pixels).any(axis=(1, 3))


def _part(whole: Body, share: float, contrast: float) -> Body:
    return replace(whole, half_mm=(share * whole.half_mm[0], share * whole.half_mm[1]), per_mm=contrast * whole.per_mm)


def _place(whole: Body, rng: np.random.Generator, low: float, high: float) -> tuple[tuple[float, float], float]:
    """Draw a point between two shares of the radius, and its direction from the centre."""
    direction, distance = rng.uniform(0.0, TAU), rng.uniform(low, high) * whole.half_mm[1]
    x, y = whole.centre_mm
    return (x + distance * math.cos(direction), y + distance * math.sin(direction)), direction


def _nail(whole: Body, nail: Nail, rng: np.random.Generator) -> Body:
    place, _ = _place(whole, rng, 0.1, 0.85)
    half, across = 0.5 * nail.diameter_mm, nail.length_mm == 0.0
    length = half if across else 0.5 * nail.length_mm
    more = (nail.times_wood - 1.0) * whole.per_mm
    return Body(place, (length, half), rng.uniform(0.0, math.pi), more, is_rod=not across)


def _rays(fan: FanBeamGeometry) -> tuple[FloatArray, FloatArray]:
    """Return the sources (views, 1, 2) in mm and the directions of all rays (views, rays, 2), in the image frame."""
    frame, pitch = fan.frame, fan.scanner.detector_pitch_mm
    within = ((np.arange(RAYS_PER_CELL) + 0.5) / RAYS_PER_CELL - 0.5) * pitch
    w = (cell_centres_mm(fan.scanner)[:, None] + within).ravel() - frame.cor_column_mm
    x = w * math.cos(frame.tilt_rad)
    y = frame.source_to_detector_mm - frame.source_distance_mm + w * math.sin(frame.tilt_rad)
    turn = (fan.angles_rad + frame.psi_rad)[:, None]
    c, s = np.cos(turn), np.sin(turn)
    sources = frame.source_distance_mm * np.stack([s, -c], axis=-1)
    rays = np.stack([c * x - s * y, s * x + c * y], axis=-1) - sources
    return sources, rays / np.linalg.norm(rays, axis=-1, keepdims=True)
