"""Scans of phantoms in counts, as a mill's scanner takes them: short flat fields, slips, and one fault more.

Exact chords of eight rays a cell make intensities, averaged over the cell; photons are counted, dark noise and gains of
3 % are the detector's, and ten flats and ten darks are averaged. Nothing here uses what the calibration models with.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from misspecified import point_inside, rounded
from scanners import PHANTOMS, SCANNER, draw_scanner, leaves_air
from scipy.ndimage import gaussian_filter1d

from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import (
    TAU,
    FloatArray,
    GeometryError,
    SourceFrame,
)
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.preparing.line_integrals import line_integrals
from sawmill_tomography.preparing.row_corrections import Corrections, RowCorrector
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_vocabulary import AirCorrection, Handedness, Rotation

RAYS, FRAMES, DARK_LEVEL, DARK_NOISE, GAIN_SPREAD = 8, 10, 200.0, 5.0, 0.03
VIEWS = (20, 45, 60, 90, 120, 180, 360)
PHOTONS = (5_000.0, 50_000.0)
OFF_CENTRE_MM = 10.0
# Air at the detector's ends, in cells, for its level to be seen.
AIR = 14
CELLS = DetectorCells.of(SCANNER)
FINE = DetectorCells(CELLS.first_border_mm, CELLS.width_mm / RAYS, CELLS.count * RAYS)

Change = Callable[[FloatArray, np.random.Generator], FloatArray]


def _same(values: FloatArray, _: np.random.Generator) -> FloatArray:
    return values


def _same_body(body: Phantom, _: np.random.Generator) -> Phantom:
    return body


def _to_intensity(lengths: FloatArray, _: np.random.Generator) -> FloatArray:
    return np.exp(-SAPWOOD_PER_MM * lengths)


@dataclass(frozen=True)
class Fault:
    """A fault of the wood, the angles, the beam (fine rays) or the detector (cells)."""

    body: Callable[[Phantom, np.random.Generator], Phantom] = _same_body
    angles: Change = _same
    beam: Change = _to_intensity
    detector: Change = _same
    counts: Change = _same


def _knot(body: Phantom, rng: np.random.Generator) -> Phantom:
    grown = Disc(point_inside(body, rng), rng.uniform(5.0, 12.0), rng.uniform(0.2, 0.5))
    return replace(body, shapes=(*body.shapes, grown))


def _worn(body: Phantom, rng: np.random.Generator) -> Phantom:
    return replace(body, shapes=tuple(rounded(shape, rng.uniform(2.0, 8.0), rng) for shape in body.shapes))


def _eccentric(angles: FloatArray, rng: np.random.Generator) -> FloatArray:
    return angles + np.deg2rad(rng.uniform(0.02, 0.2)) * np.cos(angles - rng.uniform(0.0, TAU))


def _hardened(lengths: FloatArray, _: np.random.Generator) -> FloatArray:
    shares, attenuations = (0.3, 0.4, 0.3), (1.35, 0.97, 0.74)
    beams = (share * np.exp(-SAPWOOD_PER_MM * a * lengths) for share, a in zip(shares, attenuations, strict=True))
    return np.sum(list(beams), axis=0)


def _blurred(lengths: FloatArray, rng: np.random.Generator) -> FloatArray:
    width = rng.uniform(0.5, 2.0) / FINE.width_mm
    soft: FloatArray = gaussian_filter1d(_to_intensity(lengths, rng), width, axis=1, mode="nearest")
    return soft


def _scattered(intensity: FloatArray, rng: np.random.Generator) -> FloatArray:
    halo: FloatArray = gaussian_filter1d(intensity, 60.0, axis=1, mode="nearest")
    return intensity + rng.uniform(0.005, 0.05) * halo


def _lagging(intensity: FloatArray, rng: np.random.Generator) -> FloatArray:
    kept = rng.uniform(0.01, 0.05)
    late = intensity.copy()
    for view in range(1, len(late)):
        late[view] += kept * (late[view - 1] - late[view])
    return late


def _sloped(intensity: FloatArray, rng: np.random.Generator) -> FloatArray:
    return intensity * (1.0 + rng.uniform(-0.03, 0.03) * np.linspace(-0.5, 0.5, CELLS.count))


def _flickering(intensity: FloatArray, rng: np.random.Generator) -> FloatArray:
    return intensity * (1.0 + 0.01 * rng.standard_normal((len(intensity), 1)))


def _dead_and_hot(counts: FloatArray, rng: np.random.Generator) -> FloatArray:
    dead, hot = np.split(rng.choice(CELLS.count, 8, replace=False), 2)
    counts[:, dead] = DARK_LEVEL
    counts[:, hot] *= rng.uniform(0.7, 1.3, hot.size)
    return counts


FAULTS = {
    "knot": Fault(body=_knot),
    "rounded corner": Fault(body=_worn),
    "eccentric encoder": Fault(angles=_eccentric),
    "beam hardening": Fault(beam=_hardened),
    "blur": Fault(beam=_blurred),
    "scatter": Fault(detector=_scattered),
    "lag": Fault(detector=_lagging),
    "flat-field slope": Fault(detector=_sloped),
    "source drift": Fault(detector=_flickering),
    "dead cells": Fault(counts=_dead_and_hot),
}


@dataclass(frozen=True)
class Slip:
    """A phantom that lies elsewhere after a share of the views."""

    by_mm: float
    towards_rad: float
    by_deg: float
    at: float

    @classmethod
    def random(cls, rng: np.random.Generator) -> "Slip":
        """Draw a slip of 0.3 to 0.7 mm, and up to a tenth of a degree."""
        return cls(rng.uniform(0.3, 0.7), rng.uniform(0.0, TAU), rng.uniform(-0.1, 0.1), rng.uniform(0.15, 0.85))


@dataclass(frozen=True, eq=False)
class CountedScan:
    """Counts with their flats and darks (views or frames, 1, cells), and what the scan really was."""

    counts: FloatArray
    flats: FloatArray
    darks: FloatArray
    phantom: Phantom
    angles_rad: FloatArray
    frame: SourceFrame
    slipped_at: int | None = field(default=None)

    def task(self, *, remove_rings: bool = False) -> CalibrationTask:
        """Prepare the scan as the product prepares counts."""
        stack = line_integrals(*(taken.astype(np.float32) for taken in (self.counts, self.flats, self.darks))).stack
        corrections = Corrections(AirCorrection.VIEWS, remove_rings=remove_rings)
        RowCorrector(corrections, 1, CELLS.count).correct(stack)
        return CalibrationTask(SCANNER, self.phantom, stack[:, 0].astype(np.float64), self.angles_rad, from_counts=True)


def counted_scan(
    rng: np.random.Generator,
    *,
    slip: Slip | None = None,
    fault: Fault = Fault(),
    views: tuple[int, ...] = VIEWS,
) -> CountedScan:
    """Simulate one scan of a random phantom by a random scanner of the published bounds."""
    phantom, frame, angles, at, handedness, rotation = _scanner(rng, views)
    body = fault.body(phantom, rng)
    seen = body if handedness is Handedness.AS_DRAWN else body.mirrored()
    turned = fault.angles(rotation.apply(angles), rng)
    lengths = analytic.project(seen, FINE, frame, turned, position_mm=at, rays_per_cell=1)
    view = None
    if slip is not None:
        view, towards = round(slip.at * angles.size), slip.towards_rad
        after = (at[0] + slip.by_mm * math.cos(towards), at[1] + slip.by_mm * math.sin(towards))
        twisted = replace(frame, psi_rad=frame.psi_rad + math.radians(slip.by_deg))
        lengths[view:] = analytic.project(seen, FINE, twisted, turned[view:], position_mm=after, rays_per_cell=1)
    intensity = fault.beam(lengths, rng).reshape(angles.size, CELLS.count, RAYS).mean(axis=2)
    photons = math.exp(rng.uniform(*np.log(PHOTONS)))
    level = photons * (1.0 + GAIN_SPREAD * rng.standard_normal(CELLS.count).clip(-3.0, 3.0))

    def exposed(expected: FloatArray) -> FloatArray:
        electronic = DARK_LEVEL + DARK_NOISE * rng.standard_normal(expected.shape)
        return np.rint(rng.poisson(expected) + electronic).clip(0.0, 65535.0)

    counts = fault.counts(exposed(level * fault.detector(intensity, rng)), rng)
    flats = exposed(np.tile(level, (FRAMES, 1)))
    darks = exposed(np.zeros((FRAMES, CELLS.count)))
    return CountedScan(counts[:, None], flats[:, None], darks[:, None], phantom, angles, frame, view)


def _scanner(
    rng: np.random.Generator, views: tuple[int, ...]
) -> tuple[Phantom, SourceFrame, FloatArray, tuple[float, float], Handedness, Rotation]:
    """Draw a random scanner whose shadow leaves air at both ends of the detector in every view."""
    while True:
        drawn = draw_scanner(rng, PHANTOMS, views, OFF_CENTRE_MM)
        try:
            frame = drawn.theta.source_frame(SCANNER.source_to_cor_mm)
            shadow = analytic.project(drawn.seen, CELLS, frame, drawn.rotation.apply(drawn.angles_rad))
        except GeometryError:  # a corner of the bounds that no scanner can be in
            continue
        if leaves_air(shadow, AIR):
            return drawn.drawing, frame, drawn.angles_rad, drawn.position_mm, drawn.handedness, drawn.rotation
