"""What disturbs the turn itself: an eccentric encoder and a bearing that wobbles, from pairs of opposite rays.

The view that reports the angle phi stands at phi + delta(phi), and the log is displaced across the beam by w(phi). A
ray of the fan angle gamma then belongs to the line of the angles chi + delta and gamma - w / R. Both are sums of the
first and second harmonic of phi. Unless they are fitted, they pass for a change of u_c and tau.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.drift.change import Disturbance
from sawmill_tomography.drift.opposite_rays.opposite_rays import Solution
from sawmill_tomography.drift.opposite_rays.paired_rays import PairedRays, fan_angles
from sawmill_tomography.geometry.geometry import FloatArray, Scanner

# A disturbance is found when the logarithm of its Bayes factor, against none, is above this: 3000 to 1
# (benchmarks/drift.py).
FOUND = 8.0
# The amplitudes to expect of a disturbance, as a standard deviation, and those that a sound scanner may have: where it
# is not found, its share of the covariance. Degrees of the encoder, mm of the bearing.
EXPECTED = {"encoder": 0.3, "bearing": 1.0}
SOUND = {"encoder": 0.01, "bearing": 0.02}
# A disturbance this number of times what a sound scanner may have is one: below, it stands for something else.
TIMES_SOUND = 2.5
# The number of times that disturbances are looked for: each round takes the one that explains most.
ROUNDS = 6


DISTURBANCES = (
    Disturbance("encoder", 1),
    Disturbance("encoder", 2),
    Disturbance("bearing", 1),
    Disturbance("bearing", 2),
)


@dataclass(frozen=True, eq=False)
class Harmonics:
    """Disturbances by the angle that a sense of rotation reads, as angles: delta, and - w / R of the bearing.

    Attributes
    ----------
    values : (disturbances, 2) float64
        Cosine and sine, rad.
    """

    values: FloatArray

    @classmethod
    def none(cls) -> "Harmonics":
        """Without a disturbance."""
        return cls(np.zeros((len(DISTURBANCES), 2)))

    def plus(self, found: "Estimate") -> "Harmonics":
        """With another one added."""
        values = self.values.copy()
        values[DISTURBANCES.index(found.disturbance)] += found.value
        return Harmonics(values)

    def at(self, part: str, phi: FloatArray) -> FloatArray:
        """Of the encoder or the bearing, at the angles phi (any shape), rad."""
        terms = [
            value @ _waves(each.order, phi).reshape(2, -1)
            for each, value in zip(DISTURBANCES, self.values, strict=True)
            if each.part == part
        ]
        return np.asarray(np.sum(terms, axis=0).reshape(phi.shape))

    def amplitudes(self, source_distance_mm: float) -> dict[Disturbance, float]:
        """Degrees of the encoder's, mm of the bearing's; those that are not 0."""
        size = np.hypot(*self.values.T)
        return {
            each: math.degrees(a) if each.part == "encoder" else float(a * source_distance_mm)
            for each, a in zip(DISTURBANCES, size, strict=True)
            if a > 0.0
        }


@dataclass(frozen=True, eq=False)
class Estimate:
    """A disturbance fitted with the geometry.

    Attributes
    ----------
    value : (2,) float64
        Cosine and sine, rad.
    covariance : (2, 2) float64
    sensitivity : (unknowns, 2) float64
        Change of the geometry's free unknowns per rad of either.
    """

    disturbance: Disturbance
    value: FloatArray
    covariance: FloatArray
    sensitivity: FloatArray

    def evidence(self, source_distance_mm: float) -> float:
        """The logarithm of the Bayes factor of this disturbance, of an amplitude as expected, against none."""
        wide = self.covariance + _prior(self.disturbance, EXPECTED, source_distance_mm)
        gain = self.value @ (np.linalg.inv(self.covariance) - np.linalg.inv(wide)) @ self.value
        return float(0.5 * gain - 0.5 * math.log(np.linalg.det(wide) / np.linalg.det(self.covariance)))

    def times_sound(self, source_distance_mm: float) -> float:
        """The amplitude against that which a sound scanner may have."""
        sound = math.sqrt(float(np.trace(_prior(self.disturbance, SOUND, source_distance_mm))))
        return float(np.linalg.norm(self.value)) / sound

    def moved(self, source_distance_mm: float) -> FloatArray:
        """What it may have added to the error of the unknowns (unknowns, unknowns), if the scanner is sound.

        From the second moment of the amplitude's posterior: it is as the pairs allow and as a sound scanner has it.
        """
        precision = np.linalg.inv(self.covariance)
        posterior = np.linalg.inv(precision + np.linalg.inv(_prior(self.disturbance, SOUND, source_distance_mm)))
        mean = posterior @ precision @ self.value
        return np.asarray(self.sensitivity @ (posterior + np.outer(mean, mean)) @ self.sensitivity.T, np.float64)


def _prior(disturbance: Disturbance, amplitudes: Mapping[str, float], source_distance_mm: float) -> FloatArray:
    """Covariance (2, 2) of cosine and sine, rad; the amplitude's variance is that of both together."""
    amplitude = amplitudes[disturbance.part]
    angle = math.radians(amplitude) if disturbance.part == "encoder" else amplitude / source_distance_mm
    return np.eye(2) * 0.5 * angle**2


def strongest(estimates: Sequence[Estimate], source_distance_mm: float) -> Estimate | None:
    """The disturbance that explains the differences of opposite rays best; None where none is beyond chance."""
    estimates = [each for each in estimates if each.times_sound(source_distance_mm) > TIMES_SOUND]
    if not estimates:
        return None
    best = max(estimates, key=lambda each: each.evidence(source_distance_mm))
    return best if best.evidence(source_distance_mm) > FOUND else None


def undetected_covariance(solution: Solution, estimates: Sequence[Estimate], source_distance_mm: float) -> FloatArray:
    """What disturbances that were not found may have added to the error of (u_c, tau, SDD), (3, 3)."""
    covariance = np.zeros((3, 3))
    for each in estimates:
        covariance[solution.free, solution.free] += each.moved(source_distance_mm)
    return covariance


def estimates_of(solution: Solution) -> list[Estimate]:
    """Each disturbance fitted alone beside the geometry; without those that the pairs do not show."""
    slopes = np.concatenate([_weights(each, solution.pairs.gamma, solution.pairs.chi) for each in DISTURBANCES])
    # An error of the encoder moves rays by chi, one of the bearing by gamma.
    chosen = [1 if each.part == "encoder" else 0 for each in DISTURBANCES for _ in range(2)]
    rays = solution.rays.with_unknowns(solution.derivatives, chosen, slopes)
    geometry = list(range(3))[solution.free]
    estimates = []
    for at, each in enumerate(DISTURBANCES):
        unknowns = [*geometry, 3 + 2 * at, 4 + 2 * at]
        covariance = rays.covariance(unknowns, corrected=True)
        if np.isfinite(covariance).all():
            estimates.append(_estimate(each, rays, geometry, unknowns, covariance))
    return estimates


def _estimate(
    each: Disturbance, rays: PairedRays, geometry: list[int], unknowns: list[int], covariance: FloatArray
) -> Estimate:
    gram = rays.gram(corrected=True)[unknowns][:, unknowns]
    step = -np.linalg.solve(gram, rays.scores.sum(axis=0)[unknowns])
    inside = len(geometry)
    sensitivity = np.asarray(-np.linalg.solve(gram[:inside, :inside], gram[:inside, inside:]), np.float64)
    return Estimate(each, step[inside:], covariance[inside:, inside:], sensitivity)


def _weights(each: Disturbance, gamma: FloatArray, chi: FloatArray) -> FloatArray:
    """How cosine and sine of a disturbance count of its derivative, (2, pairs, chi).

    With the sign of an unknown of the geometry: taking the disturbance out takes this off the differences.
    """
    here, there = np.exp(1j * each.order * gamma), np.exp(1j * each.order * (math.pi - gamma))
    of_pairs = there - here if each.part == "encoder" else -here - there
    waves = np.outer(of_pairs, np.exp(1j * each.order * chi))
    return np.stack([waves.real, waves.imag])


def _waves(order: int, phi: FloatArray) -> FloatArray:
    """Cosine and sine, (2, ...)."""
    return np.stack([np.cos(order * phi), np.sin(order * phi)])


def undisturbed(
    scanner: Scanner, vector: FloatArray, sinogram: FloatArray, angles_rad: FloatArray, harmonics: Harmonics
) -> tuple[FloatArray, FloatArray]:
    """Sinogram (views, cells) and angles (views,), as the sense of rotation reads them, of the turn as it would be.

    A sample at phi and gamma belongs to the view phi + delta + swing and the fan angle gamma + swing, swing = - w / R:
    the direction chi = phi - gamma of the ray stays.
    """
    swing = harmonics.at("bearing", angles_rad)
    angles = angles_rad + harmonics.at("encoder", angles_rad) + swing
    return _shifted(scanner, vector, sinogram, swing) if swing.any() else sinogram, angles


def _shifted(scanner: Scanner, vector: FloatArray, sinogram: FloatArray, swing: NDArray[np.float64]) -> FloatArray:
    """Each view moved along the detector by its swing, by cubic splines."""
    fan, covered = fan_angles(scanner, vector)
    cells = np.arange(fan.size) - swing[:, None] / covered
    views = np.broadcast_to(np.arange(len(sinogram))[:, None], cells.shape)
    return np.asarray(scipy.ndimage.map_coordinates(sinogram, [views, cells], order=3, mode="nearest"), np.float64)
