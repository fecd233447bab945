"""Production scans at random for the study of drift: the mean over a log's rows, as a mill's scanner would send it.

The mean of rows is simulated as one image. Up to `SECTIONS` cross-sections of a log are projected exactly and averaged;
their noise is a row's noise over the square root of the number of rows: white, or of counts with the flat fields' own
and with the bias of -ln at few counts. What stays in every row (slopes of the flat field, gains of views) is not
averaged. The physics is `analytic.project`'s: monochromatic, no scatter, no blur; beams harden by a parabola.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scanners import SCANNER, leaves_air

from sawmill_tomography.geometry.geometry import TAU, FloatArray, SourceFrame, Theta
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM, LogModel
from sawmill_tomography.phantoms.phantom import Disc, Phantom, Polygon, Shape
from sawmill_tomography.projection.analytic import DetectorCells, project

Nails = Literal["none", "masked", "left"]
# Cross-sections of a log that are averaged.
SECTIONS = 3
CELLS = DetectorCells.of(SCANNER)
STEEL_PER_MM = 0.5
BARK_PER_MM = 0.7 * SAPWOOD_PER_MM
# Rays a cell in its mean: with 4 the sampling of a log's edges alone moves u_c by 0.003 mm, with 8 by 0.001.
RAYS = 8
# The largest line integral that is left of the counts behind a nail.
STARVED = 9.0
# Air at either end, in cells.
AIR = 14
# Frames of flat fields, whose photon noise all views share.
FLATS = 10
MOST_HARDENED = 0.05
# Ends of the detector against each other, of what the flat fields miss and does not change from log to log.
MOST_SLOPE, MOST_BEND = 0.03, 0.01
GAIN = 0.005
OFF_CENTRE_MM = 20.0
MOST_RADIUS_MM, MOST_BARK_MM = 130.0, 12.0
BOW_MM = 1.0
# The calibration's own error of SDD: the L-shaped phantom gives about this. It stays.
DISTANCE_ERROR_MM = 0.5


@dataclass(frozen=True, eq=False)
class Mill:
    """A scanner as it stays from log to log: its geometry, the angles of its views, its flat field's error.

    Attributes
    ----------
    theta : Theta
        Geometry at the calibration.
    flat_field : (cells,) float64
        Added to every ray.
    photons : float or None
        Photons in air, a row; None where the noise is white.
    noise : float
        White noise of a row, as a share of the RMS.
    encoder_deg : float
        Amplitude of the angles' error once a turn.
    """

    theta: Theta
    angles_rad: FloatArray
    turn: str
    rows: int
    flat_field: FloatArray
    photons: float | None
    noise: float
    hardened: float
    encoder_deg: float = 0.0

    @classmethod
    def random(cls, rng: np.random.Generator, views: int, rows: int, *, encoder_deg: float = 0.0) -> "Mill":
        """Draw a scanner within the range that the drift check states."""
        theta = _theta(rng)
        turn, angles = _angles(rng, views)
        across = np.linspace(-0.5, 0.5, SCANNER.num_detector_pixels)
        slope, bend = rng.uniform(-MOST_SLOPE, MOST_SLOPE), rng.uniform(-MOST_BEND, MOST_BEND)
        photons = float(10.0 ** rng.uniform(3.5, 4.5)) if rng.uniform() < 0.5 else None
        return cls(
            theta,
            angles,
            turn,
            rows,
            slope * across + bend * (2.0 * across) ** 2,
            photons,
            float(rng.uniform(0.01, 0.04)),
            float(rng.uniform(0.0, MOST_HARDENED)),
            encoder_deg,
        )

    def frame(self, drift: "Drift | None" = None) -> SourceFrame:
        """Return the geometry, with a drift applied if there is one."""
        frame = self.theta.source_frame(SCANNER.source_to_cor_mm)
        return frame if drift is None else drift.applied(frame)

    def calibrated(self, rng: np.random.Generator) -> SourceFrame:
        """Return the geometry as a calibration has it, with a small error of SDD."""
        truth = self.frame()
        wrong = float(rng.normal(0.0, DISTANCE_ERROR_MM))
        return replace(truth, source_to_detector_mm=truth.source_to_detector_mm + wrong)

    def look(self, rng: np.random.Generator, drift: "Drift | None" = None, *, nails: Nails = "none") -> FloatArray:
        """Simulate a log's line integrals (views, cells): the mean of rows, in some of which there may be nails."""
        frame, stated = self.frame(drift), self.angles_rad
        # Where a log is put on the turntable is as random as the phase.
        true = stated + math.radians(self.encoder_deg) * np.cos(stated)
        sections = random_sections(rng, min(self.rows, SECTIONS))
        bare = np.stack([project(body, CELLS, frame, true, rays_per_cell=RAYS) for body in sections])
        bare *= 1.0 - self.hardened * bare / bare.max()
        rays = bare.mean(axis=0)
        if nails != "none":
            rays += _of_nails(rng, rays, bare[0], frame, true, masked=nails == "masked")
        if self.photons is None:
            deviation = np.full_like(rays, self.noise * math.sqrt(float(np.mean(rays**2)) / self.rows))
        else:
            thin = np.exp(rays) / self.photons
            deviation = np.sqrt(thin / self.rows)
            # -ln of few counts is too large by half their relative variance; the flat fields have noise of their own.
            rays += 0.5 * thin + rng.standard_normal(rays.shape[1]) / math.sqrt(FLATS * self.photons * self.rows)
        gains = 1.0 + GAIN * rng.standard_normal((len(rays), 1))
        return rays * gains + self.flat_field + deviation * rng.standard_normal(rays.shape)


@dataclass(frozen=True)
class Drift:
    """A drift: u_c moved by mm, tau by rad."""

    column_mm: float
    tilt_rad: float

    def applied(self, frame: SourceFrame) -> SourceFrame:
        """Return the geometry after the drift."""
        return replace(
            frame, cor_column_mm=frame.cor_column_mm + self.column_mm, tilt_rad=frame.tilt_rad + self.tilt_rad
        )


def random_sections(rng: np.random.Generator, number: int) -> list[Phantom]:
    """Draw cross-sections of one log: elliptic, with bark, wet zones and knots, off centre, and a little bowed."""
    radius, seed = rng.uniform(80.0, MOST_RADIUS_MM), int(rng.integers(1 << 30))
    log = LogModel.random(seed, radius_mm=radius)
    aspect, shear = rng.uniform(-0.08, 0.08, 2)
    bark = rng.uniform(0.0, MOST_BARK_MM)
    off = OFF_CENTRE_MM * math.sqrt(rng.uniform())
    towards = rng.uniform(0.0, TAU)
    wet = [_patch(rng, radius) for _ in range(rng.integers(0, 4))]
    sections = []
    for height in rng.uniform(30.0, 370.0, number):
        wood = log.slice_at(float(height))
        # The model's own nail has no place here.
        shapes: list[Shape] = [shape for shape in wood.shapes if shape.density < 10.0 * SAPWOOD_PER_MM]
        outside, inside = (Disc((0.0, 0.0), size, BARK_PER_MM) for size in (radius + bark, radius))
        shapes += [outside, replace(inside, density=-BARK_PER_MM)]
        body = Phantom("log", (*shapes, *wet)).deformed(aspect, shear)
        bow = rng.normal(0.0, BOW_MM, 2)
        sections.append(body.moved(off * math.cos(towards) + bow[0], off * math.sin(towards) + bow[1]))
    return sections


def _theta(rng: np.random.Generator) -> Theta:
    """Draw a scanner on whose detector any log leaves air at both ends."""
    while True:
        theta = Theta(*rng.uniform([0.0, 600.0, -300.0, -100.0, -0.3], [TAU, 850.0, 300.0, 100.0, 0.3]))
        if holds_any_log(theta):
            return theta


def holds_any_log(theta: Theta) -> bool:
    """Return whether the largest log, at the largest offset, leaves air at both ends of the detector."""
    largest = Phantom("largest", (Disc((0.0, 0.0), 1.1 * (MOST_RADIUS_MM + MOST_BARK_MM) + OFF_CENTRE_MM),))
    frame = theta.source_frame(SCANNER.source_to_cor_mm)
    return leaves_air(project(largest, CELLS, frame, np.zeros(1), rays_per_cell=1), AIR)


def _patch(rng: np.random.Generator, radius_mm: float) -> Polygon:
    """Draw a wet or dry zone, up to 30 % denser or less dense than sapwood."""
    turn = np.sort(rng.uniform(0.0, TAU, 7))
    depth, towards = rng.uniform(0.0, 0.6) * radius_mm, rng.uniform(0.0, TAU)
    size = rng.uniform(0.1, 0.35) * radius_mm
    x, y = depth * math.cos(towards), depth * math.sin(towards)
    corners = tuple((x + size * math.cos(t), y + size * math.sin(t)) for t in turn.tolist())
    return Polygon(corners, float(rng.uniform(-0.3, 0.3)) * SAPWOOD_PER_MM)


def _of_nails(
    rng: np.random.Generator, rays: FloatArray, row: FloatArray, frame: SourceFrame, true: FloatArray, *, masked: bool
) -> FloatArray:
    """Compute the change of the mean (views, cells) of all rows by nails in a few per cent of the rows."""
    places = zip(rng.uniform(0.0, TAU, 3), rng.uniform(20.0, 80.0, 3), rng.uniform(1.0, 4.0, 3), strict=True)
    discs = tuple(Disc((d * math.cos(t), d * math.sin(t)), r, STEEL_PER_MM) for t, d, r in places)
    steel = project(Phantom("nails", discs[: rng.integers(1, 4)]), CELLS, frame, true, rays_per_cell=RAYS)
    share = rng.uniform(0.02, 0.06)
    if not masked:
        # The counts behind a nail starve.
        return share * (np.minimum(row + steel, STARVED) - row)
    # Where they show a nail these rows are missing, and the others differ from them.
    return np.where(steel > 0.0, share / (1.0 - share) * (rays - row), 0.0)


def _angles(rng: np.random.Generator, views: int) -> tuple[str, FloatArray]:
    """Draw angles: mostly an even turn; else views lost, at random angles, or over part of the turn."""
    even = (np.arange(views) + rng.uniform()) * TAU / views
    chance = rng.uniform()
    if chance < 0.6:
        return "even turn", even
    if chance < 0.75 and views > 10:
        return "lost views", np.delete(even, rng.choice(views, rng.integers(1, 4), replace=False))
    if chance < 0.9:
        return "random angles", np.sort(rng.uniform(0.0, TAU, views))
    return "part of a turn", even[0] + np.arange(views) * rng.uniform(0.6, 0.9) * TAU / views
