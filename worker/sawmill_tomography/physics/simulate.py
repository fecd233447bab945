"""A scan of a phantom in a mill: counts with flat and dark fields, and the truth."""

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.geometry.detector_shape import lines_of
from sawmill_tomography.geometry.geometry import TAU, FloatArray, GeometryError, Scanner, SourceFrame
from sawmill_tomography.phantoms.phantom import Phantom, Polygon, counter_clockwise
from sawmill_tomography.physics._chords_numba import CROSSINGS, transmit
from sawmill_tomography.physics.body import Motion, WornBody, move, stand
from sawmill_vocabulary.physics import DetectorEffects, Physics

# Constants of every detector: counts without light, electronic noise in photons, number of flat and of dark fields.
DARK_LEVEL, DARK_NOISE_PHOTONS, FIELDS = 200.0, 5.0, 10
# For a converter of 12 bits: counts without light and in air, as shares of the largest value.
DARK_OF_12_BITS, AIR_OF_12_BITS = 0.02, 0.8
# Largest sum of photons and dark level in 16 bits where a photon is a count.
LARGEST_COUNTS = 60_000.0
# Largest relative change of a hot cell's gain.
HOT = 0.3

Counts = NDArray[np.uint16]


def signal(transmission: FloatArray, pitch_mm: float, effects: Physics, tube: FloatArray) -> FloatArray:
    """Return the signal of the cells relative to a flat field, (views, cells).

    `transmission` (views, cells). `tube` (views,): tube output in each view.
    """
    beam, detector = effects.beam, effects.detector
    halo = _halo(1.0 - transmission, beam.scatter_width_mm / pitch_mm) if beam.scatter_share else 0.0
    received = (transmission + beam.scatter_share * halo) * tube[:, None]
    if detector.glare_share:
        spread = _halo(received, detector.glare_width_mm / pitch_mm)
        received = (1.0 - detector.glare_share) * received + detector.glare_share * spread
    if detector.lag_share:
        kept = detector.lag_share
        received = scipy.signal.lfilter([1.0 - kept], [1.0, -kept], received, axis=0, zi=kept * received[:1])[0]
    # Since the flat fields the cells' gain has changed by a line and a parabola across the detector.
    place = np.linspace(-1.0, 1.0, transmission.shape[1])
    gain = 1.0 + 0.5 * detector.slope_share * place + detector.curvature_share * (1.0 / 3.0 - place**2)
    return np.asarray(received * gain)


def _halo(values: FloatArray, width: float) -> FloatArray:
    return np.asarray(scipy.ndimage.gaussian_filter1d(values, width, axis=1, mode="nearest"))


def tube_output(views: int, effects: Physics, rng: np.random.Generator) -> FloatArray:
    """Draw the tube output of each view, (views,), at least 0."""
    drift = effects.beam.drift_share * np.linspace(0.0, 1.0, views)
    return np.maximum(1.0 + drift + effects.beam.flicker_share * rng.standard_normal(views), 0.0)


@dataclass(frozen=True, eq=False)
class Converter:
    """A converter of photons to counts."""

    gain: FloatArray  # (cells,): gain of each cell, about 1
    counts_per_photon: float
    dark_level: float
    largest: float

    @classmethod
    def of(cls, detector: DetectorEffects, photons: float, cells: int, rng: np.random.Generator) -> "Converter":
        """Make the converter of a detector whose cells receive this number of photons in air."""
        largest = 2.0**detector.bits - 1.0
        twelve = detector.bits == 12
        dark = DARK_OF_12_BITS * largest if twelve else DARK_LEVEL
        air = detector.air_of_full_scale or (AIR_OF_12_BITS if twelve else None)
        if air is None and photons + dark > LARGEST_COUNTS:
            raise GeometryError(
                f"{photons:g} photons and a dark level of {dark:g} do not fit 16 bits: {LARGEST_COUNTS:g} in all; ask "
                "for fewer photons, or state air_of_full_scale"
            )
        if air is not None and air * largest <= dark:
            raise GeometryError(
                f"air at {air:g} of the full scale is {air * largest:.0f} counts, no more than the dark level of "
                f"{dark:.0f}: raise air_of_full_scale"
            )
        gain = 1.0 + detector.gain_spread * rng.standard_normal(cells).clip(-3.0, 3.0)
        return cls(gain, 1.0 if air is None else (air * largest - dark) / photons, dark, largest)

    def expose(self, photons: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw counts, whole numbers, from the photons expected in each cell, (views, cells)."""
        electronic = DARK_NOISE_PHOTONS * rng.standard_normal(photons.shape)
        analogue = self.counts_per_photon * (rng.poisson(photons * self.gain) + electronic) + self.dark_level
        return np.asarray(np.rint(analogue).clip(0.0, self.largest))


def spoil(counts: FloatArray, converter: Converter, effects: DetectorEffects, rng: np.random.Generator) -> Counts:
    """Spoil the cells that have died or changed since the flat fields."""
    chosen = rng.permutation(counts.shape[1])
    dead, hot = chosen[: effects.dead_cells], chosen[effects.dead_cells :][: effects.hot_cells]
    counts[:, dead] = np.rint(converter.dark_level)
    counts[:, hot] = np.rint(counts[:, hot] * rng.uniform(1.0 - HOT, 1.0 + HOT, hot.size)).clip(0.0, converter.largest)
    return counts.astype(np.uint16)


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
    step_rad = float(np.median(np.abs(np.diff(angles_rad)))) if angles_rad.size > 1 else 0.0
    passed = transmission(body, scanner, frame, motion, effects, step_rad)
    received = signal(passed, scanner.detector_pitch_mm, effects, tube)
    exposed = converter.expose(collected * received, noise)
    flats, darks = (converter.expose(np.full((fields, cells), level), noise) for level in (collected, 0.0))
    counts = spoil(exposed, converter, effects.detector, _stream(seed, _SPOILT, row))
    return MillScan(counts, flats.astype(np.uint16), darks.astype(np.uint16), received, frame, body, motion)


def _stream(seed: int, *which: int) -> np.random.Generator:
    return np.random.default_rng((seed, *which))


# Number of rays of a cell that only averages, and of a cell with blur, a focal spot or an exposure too.
RAYS, BLURRED_RAYS = 8, 32
ENERGY_SHARES = (0.3, 0.4, 0.3)
# Steel's attenuation falls faster with the energy than wood's: photoelectric against Compton.
STEEL_EXPONENT = 2.5
# The real root of x^3 = x + 1.
PLASTIC_NUMBER = 1.324717957244746


def transmission(
    body: WornBody, scanner: Scanner, frame: SourceFrame, motion: Motion, effects: Physics, step_rad: float
) -> FloatArray:
    """Compute the mean transmission of each cell, (views, cells) float64."""
    moved = float(np.hypot(*motion.offset_mm.T).max() + np.hypot(*motion.hall_mm.T).max())
    if body.wood.radius_mm + moved > 0.95 * frame.source_distance_mm * math.cos(frame.tilt_rad):
        raise GeometryError(
            f"the phantom {body.wood.name!r} reaches {body.wood.radius_mm + moved:.4g} mm from the centre of rotation, "
            f"so far that it touches the source at {frame.source_distance_mm:.4g} mm"
        )
    polygons = [counter_clockwise(shape) for shape in body.wood.shapes if isinstance(shape, Polygon)]
    out = np.empty((motion.angles_rad.size, scanner.num_detector_pixels))
    body_arguments = (
        np.concatenate([np.empty((0, 2)), *polygons]),
        np.cumsum([0, *map(len, polygons)]),
        np.array([shape.density for shape in body.wood.shapes if isinstance(shape, Polygon)], np.float64),
        body.wood.discs,
        body.grain,
        body.metal,
        body.slope_per_mm,
    )
    most, pitch = 0, scanner.detector_pitch_mm
    rays, lines = ray_samples(pitch, frame, effects, step_rad), lines_of(scanner, frame)
    for first, end, *line in zip(*lines[:5], strict=True):
        part = np.empty((len(out), end - first))
        crossings = transmit(
            *body_arguments,
            np.array([frame.source_distance_mm, *line]),
            np.stack([motion.angles_rad + frame.psi_rad, motion.turn_rad], -1),
            np.ascontiguousarray(motion.offset_mm),
            np.ascontiguousarray(motion.hall_mm),
            rays,
            _energies(effects.beam.energy_spread),
            (first + 0.5 - 0.5 * scanner.num_detector_pixels) * pitch,
            pitch,
            part,
        )
        out[:, first:end], most = part, max(most, crossings)
    if most > CROSSINGS:
        raise GeometryError(f"a ray crosses {most} sides of the phantom, where {CROSSINGS} can be followed: smooth it")
    past = effects.beam.past_end_share
    return (1.0 - past) * out + past


def ray_samples(pitch_mm: float, frame: SourceFrame, effects: Physics, step_rad: float) -> FloatArray:
    """Return the rays that a cell averages, (rays, 3): positions in the cell and of the source in mm, and angle.

    Without blur, spot or exposure the positions are equidistant. Otherwise they are quantiles of the cell with its
    blur, and the rays are spread evenly over all three (an additive recurrence; Roberts 2018), in pairs of opposites,
    so that nothing is displaced in the mean.
    """
    spot_mm = effects.beam.focal_blur_mm / (frame.magnification - 1.0)
    exposed_rad = effects.motion.exposure_steps * step_rad
    blur_mm = effects.detector.blur_mm
    if not (spot_mm or exposed_rad or blur_mm):
        places = ((np.arange(RAYS) + 0.5) / RAYS - 0.5) * pitch_mm
        return np.stack([places, np.zeros(RAYS), np.zeros(RAYS)], -1)
    pairs = BLURRED_RAYS // 2
    spots = scipy.special.ndtri(_recurrent(pairs, 1))
    times = exposed_rad * (_recurrent(pairs, 2) - 0.5)
    places = _cell_quantiles((np.arange(pairs) + 0.25) / pairs, pitch_mm, blur_mm)
    half = np.stack([places, spot_mm * spots / np.sqrt(np.mean(spots**2)), times], -1)
    return np.concatenate([half, -half])


def _recurrent(number: int, dimension: int) -> FloatArray:
    """Spread numbers over [0, 1], evenly in any dimension: multiples of a power of the plastic number, modulo 1."""
    return np.asarray((0.5 + np.arange(1, number + 1) * PLASTIC_NUMBER**-dimension) % 1.0)


def _cell_quantiles(shares: FloatArray, pitch_mm: float, blur_mm: float) -> FloatArray:
    """Return the positions up to which a cell with its blur, a box with a Gaussian, receives these shares of light."""
    if not blur_mm:
        return pitch_mm * (shares - 0.5)
    reach = 0.5 * pitch_mm + 6.0 * blur_mm
    places = np.linspace(-reach, reach, 4001)
    ends = (places[:, None] + 0.5 * pitch_mm * np.array([1.0, -1.0])) / blur_mm
    # The integral of the normal distribution's integral.
    received = ends * scipy.special.ndtr(ends) + np.exp(-0.5 * ends**2) / math.sqrt(TAU)
    return np.interp(shares, (received[:, 0] - received[:, 1]) * blur_mm / pitch_mm, places)


def _energies(spread: float) -> FloatArray:
    """Return rows (share, factor of wood, factor of steel); one energy where there is no spread."""
    if not spread:
        return np.ones((1, 3))
    factors = np.array([1.0 + spread, 1.0, 1.0 - spread])
    return np.stack([np.array(ENERGY_SHARES), factors, factors**STEEL_EXPONENT], -1)
