"""A scan of a phantom in a mill: counts with flat and dark fields, and the truth."""

from dataclasses import dataclass

import numpy as np

from sawmill_tomography.geometry.geometry import FloatArray, Scanner, SourceFrame
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.physics.body import Motion, WornBody, move, stand
from sawmill_tomography.physics.detector import FIELDS, Converter, Counts, signal, spoil, tube_output
from sawmill_tomography.physics.transmission import transmission
from sawmill_vocabulary.physics import Physics

# Streams of random numbers: equal seeds give equal wood and motion, whatever other effects are on.
_WOOD, _MOTION, _TUBE, _CELLS, _NOISE, _SPOILT = range(6)
NOTHING = Physics()


@dataclass(frozen=True, eq=False)
class MillScan:
    """A scan of one detector row."""

    counts: Counts  # (views, cells) uint16
    flats: Counts  # (fields, cells) uint16
    darks: Counts  # (fields, cells) uint16
    signal: FloatArray  # (views, cells)
    frame: SourceFrame  # the true geometry
    body: WornBody  # the body in the beam, and its motion
    motion: Motion


def simulate_physics(
    phantom: Phantom,
    scanner: Scanner,
    frame: SourceFrame,
    angles_rad: FloatArray,
    effects: Physics = NOTHING,
    *,
    photons: float = 30_000.0,
    fields: int = FIELDS,
    seed: int,
    row: int = 0,
) -> MillScan:
    """Simulate a mill's scan of a phantom.

    Parameters
    ----------
    phantom : Phantom
        The phantom from the side that is seen, at its position; densities in attenuation per mm.
    angles_rad : (views,) float64
        Angles that the scanner reports, in its sense of rotation.
    photons : float
        Photons in air for each cell and view.
    fields : int
        Number of flat fields, and of dark fields.
    seed : int
        Seed of all random numbers. Rows of one stack share the wood, the motion and the tube.
    row : int
        Number of the row, which has its own cells and photons.

    Raises
    ------
    GeometryError
        If the phantom reaches the source, air is no brighter than the dark level, or counts do not fit 16 bits.
    """
    collected = photons * effects.beam.row_share
    cells, noise = scanner.num_detector_pixels, _stream(seed, _NOISE, row)
    converter = Converter.of(effects.detector, collected, cells, _stream(seed, _CELLS, row))
    body = stand(phantom, effects.wood, _stream(seed, _WOOD))
    motion = move(angles_rad, effects.motion, _stream(seed, _MOTION))
    tube = tube_output(angles_rad.size, effects, _stream(seed, _TUBE))
    passed = transmission(body, scanner, frame, motion, effects, _step(angles_rad))
    received = signal(passed, scanner.detector_pitch_mm, effects, tube)
    exposed = converter.expose(collected * received, noise)
    flats, darks = (converter.expose(np.full((fields, cells), level), noise) for level in (collected, 0.0))
    counts = spoil(exposed, converter, effects.detector, _stream(seed, _SPOILT, row))
    return MillScan(counts, flats.astype(np.uint16), darks.astype(np.uint16), received, frame, body, motion)


def _stream(seed: int, *which: int) -> np.random.Generator:
    return np.random.default_rng((seed, *which))


def _step(angles_rad: FloatArray) -> float:
    """Return the angle between neighbouring views, rad."""
    return float(np.median(np.abs(np.diff(angles_rad)))) if angles_rad.size > 1 else 0.0
