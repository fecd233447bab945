"""Passages of a body through a scanner of fixed pairs: counts with flat and dark fields of each pair."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sawmill_tomography.geometry.geometry import FloatArray, SourceFrame, rotate
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.physics.body import Motion, stand
from sawmill_tomography.physics.simulate import (
    FIELDS,
    NOTHING,
    Converter,
    Counts,
    signal,
    spoil,
    transmission,
    tube_output,
)
from sawmill_vocabulary import CellOrder, PairedScanner
from sawmill_vocabulary.physics import Physics

_WOOD, _TUBE, _CELLS, _NOISE, _SPOILT = range(5)


@dataclass(frozen=True)
class Passage:
    """How a body lies in one passage: its place and roll at height 0, and their slopes along the feed."""

    place_mm: tuple[float, float] = (0.0, 0.0)
    roll_rad: float = 0.0
    slope: tuple[float, float] = (0.0, 0.0)  # of the place, mm per mm
    twist_rad_per_mm: float = 0.0

    def place_of(self, point_mm: tuple[float, float, float]) -> tuple[float, float, float]:
        """Return where a point (x, y, height) of the body lies in the scanner, mm."""
        *across, height = point_mm
        rolled = np.array(rotate(self.roll_rad + height * self.twist_rad_per_mm, *across))
        x, y = rolled + self.place_mm + height * np.array(self.slope)
        return float(x), float(y), height


@dataclass(frozen=True, eq=False)
class PassedPair:
    """What one pair measures of all passages."""

    counts: Counts  # (passages, rows, cells) uint16
    flats: Counts  # (fields, cells)
    darks: Counts  # (fields, cells)


def simulate_passages(
    body: Phantom | Callable[[float], Phantom],
    scanner: PairedScanner,
    frames: Sequence[SourceFrame],
    passages: Sequence[Passage],
    effects: Physics = NOTHING,
    *,
    rows: int = 1,
    row_pitch_mm: float = 2.0,
    photons: float = 30_000.0,
    seed: int,
) -> list[PassedPair]:
    """Simulate passages of a body through a scanner whose pairs have these true frames.

    Parameters
    ----------
    body : Phantom, or callable
        The body from the side that is seen, the same at each height, or its cross-section at a height in mm; densities
        in attenuation per mm.
    frames : sequence of SourceFrame
        The true geometry of each pair.
    rows, row_pitch_mm : int, float
        Rows of a passage along the feed, and their distance, mm; the middle of the rows has height 0.
    photons : float
        Photons in air for each cell and row.

    Raises
    ------
    GeometryError
        If the body reaches a source, or counts do not fit 16 bits.
    """
    heights = (np.arange(rows) - 0.5 * (rows - 1)) * row_pitch_mm
    passed = []
    for number, (pair, frame) in enumerate(zip(scanner.pairs, frames, strict=True)):
        cells, at = pair.num_detector_pixels, heights + pair.feed_offset_mm
        converter = Converter.of(effects.detector, photons, cells, np.random.default_rng((seed, number, _CELLS)))
        offsets = np.concatenate([one.place_mm + at[:, None] * one.slope for one in passages])
        rolls = np.concatenate([one.roll_rad + at * one.twist_rad_per_mm for one in passages])
        sections = [body] if isinstance(body, Phantom) else [body(float(height)) for height in at]
        through = np.empty((len(passages) * rows, cells))
        for first, section in enumerate(sections):
            wood = stand(section, effects.wood, np.random.default_rng((seed, _WOOD)))
            seen = slice(first, None, len(sections))
            still = np.zeros_like(offsets[seen])
            motion = Motion(still[:, 0], rolls[seen], offsets[seen], still, None)
            through[seen] = transmission(wood, pair.scanner, frame, motion, effects, 0.0)
        received = _received(through, pair.detector_pitch_mm, effects, len(passages), (seed, number, _TUBE))
        noise = np.random.default_rng((seed, number, _NOISE))
        exposed = converter.expose(photons * received, noise)
        fields = [converter.expose(np.full((FIELDS, cells), level), noise) for level in (photons, 0.0)]
        counts = spoil(exposed, converter, effects.detector, np.random.default_rng((seed, number, _SPOILT)))
        flats, darks = (field.astype(np.uint16) for field in fields)
        way = -1 if pair.cell_order is CellOrder.COUNTER_CLOCKWISE else 1
        shape = len(passages), rows, cells
        passed.append(PassedPair(counts[:, ::way].reshape(shape), flats[:, ::way], darks[:, ::way]))
    return passed


def _received(
    through: FloatArray, pitch_mm: float, effects: Physics, passages: int, seed: tuple[int, ...]
) -> FloatArray:
    """Return the signals of all rows, (views, cells); the tube and the detector's lag start again in each passage."""
    rng = np.random.default_rng(seed)
    return np.concatenate(
        [signal(part, pitch_mm, effects, tube_output(len(part), effects, rng)) for part in np.split(through, passages)]
    )
