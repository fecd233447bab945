"""Counts from transmissions: effects of the hall and the detector, photons, and the converter."""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FloatArray, GeometryError
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
    return np.asarray(received * _gain_change(detector, transmission.shape[1]))


def _halo(values: FloatArray, width: float) -> FloatArray:
    return np.asarray(scipy.ndimage.gaussian_filter1d(values, width, axis=1, mode="nearest"))


def _gain_change(detector: DetectorEffects, cells: int) -> FloatArray:
    """Return the cells' gain change since the flat fields, (cells,): a line and a parabola across the detector."""
    place = np.linspace(-1.0, 1.0, cells)
    return np.asarray(1.0 + 0.5 * detector.slope_share * place + detector.curvature_share * (1.0 / 3.0 - place**2))


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
