"""The most probable image under independent noise and Cauchy-distributed differences: flat wood, sharp edges."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from sawmill_tomography.geometry.geometry import FloatArray, GeometryError
from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.reconstruction.estimate import Estimate
from sawmill_tomography.reconstruction.iterative.coarse_to_fine import typical_attenuation
from sawmill_tomography.reconstruction.iterative.cross_validation import cross_validate, parabola_minimum
from sawmill_tomography.reconstruction.iterative.descent import Floats, Images, OnIteration
from sawmill_tomography.reconstruction.iterative.edge_preserving import (
    EdgePreservingMethod,
    PriorProblem,
    Settings,
    reconstruct_with_prior,
)
from sawmill_tomography.reconstruction.iterative.penalised import Objective, weights_of
from sawmill_tomography.reconstruction.iterative.priors import CauchyPrior
from sawmill_tomography.reconstruction.iterative.progress import OnProgress, Phases, counting_iterations, part_of
from sawmill_tomography.reconstruction.iterative.synthetic_tuning import ITERATIONS as TUNING_ITERATIONS
from sawmill_tomography.reconstruction.iterative.synthetic_tuning import SyntheticTuning
from sawmill_tomography.reconstruction.method import CANDIDATES_AT_ONCE, IMAGES_OF_A_DESCENT, FittedMethod
from sawmill_tomography.reconstruction.total_variation import total_variation
from sawmill_tomography.reconstruction.total_variation_weights import choose_weight
from sawmill_tomography.sinograms.noise import noise_of_each_ray, rms_noise

# The exponent of the Cauchy density in the plane (docs/understand/reconstruction.md#methods).
STRENGTH = 1.5
# Beta over the typical attenuation, times the square root of the pixels across the log: with smaller pixels the
# differences on a slope are smaller, the differences at an edge are not. This and the constants of the choice below
# were found on simulated logs (benchmarks/choosing.py).
BETA_SHARE = 4.7
# Candidates for sigma at the usual beta, as multiples of the noise.
SIGMA_FACTORS = np.geomspace(0.6, 3.0, 5)
# Candidates for beta, as multiples of the usual one, and the power of beta with which the best sigma varies.
BETA_STEPS = 8.0 ** np.linspace(-0.75, 0.25, 5)
SIGMA_POWER = 0.6
# Candidates for sigma at each beta, as multiples of the sigma that this power predicts.
NEAR_FACTORS = np.geomspace(0.7, 1.0 / 0.7, 3)
# Beta is also judged by the edges in validation views: the exponent of their frequencies, the weight of the logarithm
# of that error next to the error of the synthetic tuning, and the iterations of those images.
EDGE_EXPONENT, VALIDATION_WEIGHT, VALIDATION_ITERATIONS = 1.5, 30.0, 8
# The penalty on a beta other than the usual one, times the logarithm of the step.
STEP_PENALTY = 0.4
# The reference image need not converge further.
REFERENCE_TOLERANCE = 1e-3
ITERATIONS = 400
TOLERANCE = 2e-5
# Iterations after which most logs have converged (benchmarks/iterative.py at 3ab7f653).
USUAL_ITERATIONS = 40
# Projections forward and back with the continuation (benchmarks/iterative.py at 3ab7f653).
USUAL_PAIRS = 105.0
# Cost of choosing sigma and beta, in iterations on one slice, and the shares of its parts: the weight of total
# variation, the reference image, the candidates and the validation. Measured on 256 x 256 pixels from 20 views
# (benchmarks/choosing.py).
CHOOSING_COST = 800.0
WEIGHT_COST, REFERENCE_COST, SIGMA_COST, BETA_COST, VALIDATION_COST = 0.29, 0.02, 0.07, 0.41, 0.21


@dataclass(frozen=True)
class Preset:
    """Settings that belong together; `corner` is the scale of the penalty on the corner pixel."""

    sigma: float
    beta: float
    corner: float
    iterations: int
    non_negative: bool


# The published settings for logs from few views (arXiv 2206.14444): in the unit of that log, whose wood is about 0.4.
PRESETS = {"paper": Preset(sigma=0.3, beta=0.01, corner=0.1, iterations=150, non_negative=False)}


@dataclass(frozen=True)
class NoiseMultiple:
    """A sigma that follows the noise of each ray."""

    factor: float


def cauchy_map(
    projector: Projector,
    sinogram: ArrayLike,
    *,
    sigma: ArrayLike | NoiseMultiple | None = None,
    beta: float | None = None,
    noise: ArrayLike | None = None,
    preset: Literal["paper"] | None = None,
    non_negative: bool = True,
    iterations: int = ITERATIONS,
    tolerance: float = TOLERANCE,
    on_progress: OnProgress | None = None,
) -> Estimate:
    """Reconstruct one slice or a block of slices with a Cauchy prior (docs/understand/reconstruction.md#methods).

    The objective is 1/2 sum ((A x - y) / sigma)^2 + 3/2 sum log(1 + |d|^2 / beta^2): zero for a flat image that
    explains the data. The estimate's parameters are `sigma`, (1,), the root mean square over all rays, and `beta`,
    (slices,).

    Parameters
    ----------
    projector : Projector
        Geometry and image grid; any angles.
    sinogram : (views, detector) or (slices, views, detector) float
        Line integrals whose air is at 0.
    sigma : float or (views, detector) or NoiseMultiple, optional
        Assumed standard deviation of the data, in the sinogram's unit. By default a multiple of the noise, the
        same for all slices, which `choose_sigma_and_beta` chooses on the middle slice.
    beta : float, optional
        Scale of the differences between neighbouring pixels, in attenuation; by default chosen together with sigma,
        or a share of the wood's where sigma is given.
    noise : float or (views, detector), optional
        Standard deviation of the data, for sigma and the misfit: `photon_noise` where counts are known; by default
        the standard deviation of the air.
    preset : {"paper"}, optional
        The published settings, in place of sigma, beta, non_negative and iterations.
    non_negative : bool
        Attenuation is at least 0.
    iterations, tolerance
        The descent ends when its last iterations lower the objective by less than this share, or are used up.
    on_progress : callable, optional
        Called with the finished share of the work, which rises to 1, after each iteration.

    Raises
    ------
    GeometryError
        If shapes do not fit, a value is not positive, or a slice is 0 in every ray.
    """
    corner = None
    if preset is not None:
        published = PRESETS[preset]
        sigma, beta, corner = published.sigma, published.beta, published.corner
        iterations, non_negative = published.iterations, published.non_negative

    def settings(problem: PriorProblem, choice: SigmaAndBeta | None) -> Settings:
        if choice is not None:
            return _settings(problem, choice.sigma, choice.beta, corner)
        return _settings(problem, sigma, beta, corner)

    method = EdgePreservingMethod(
        choose=partial(choose_sigma_and_beta, beta=beta, non_negative=non_negative) if sigma is None else None,
        settings=settings,
        choosing_cost=CHOOSING_COST,
        usual_iterations=USUAL_ITERATIONS,
        as_published=preset is not None,
    )
    problem = PriorProblem.of(projector, sinogram, noise, non_negative=non_negative)
    return reconstruct_with_prior(method, problem, iterations=iterations, tolerance=tolerance, on_progress=on_progress)


@dataclass(frozen=True, eq=False)
class SigmaAndBeta:
    """Sigma and beta for one slice."""

    sigma: NoiseMultiple
    beta: float
    image: Image  # (size, size) float32: image near the one with both


def choose_sigma_and_beta(
    projector: Projector,
    sinogram: ArrayLike,
    *,
    beta: float | None = None,
    noise: ArrayLike | None = None,
    non_negative: bool = True,
    on_progress: OnProgress | None = None,
) -> SigmaAndBeta:
    """Choose sigma and beta for a sinogram (views, detector).

    The best smoothness, sigma and beta together, is found by tuning on a synthetic scan of the slice's total variation
    image (`SyntheticTuning`); beta, many small steps or few large ones, by cross-validation.

    Parameters are documented in `cauchy_map`; a given beta is kept.
    """
    problem = PriorProblem.of(projector, sinogram, noise, non_negative=non_negative)
    noises, support, line = problem.noises, problem.support, problem.lines[0]
    usual_beta = float(_betas(beta, problem)[0])
    open_beta = beta is None
    phases = Phases(
        on_progress,
        weight=WEIGHT_COST,
        reference=REFERENCE_COST,
        sigma=SIGMA_COST,
        beta=BETA_COST if open_beta else 0.0,
        validation=VALIDATION_COST if open_beta else 0.0,
    )
    smooth = choose_weight(
        support.projector, line, noise=noises[0], non_negative=non_negative, on_progress=phases.of("weight")
    )
    reference = total_variation(
        support.projector,
        line,
        weight=smooth.weight,
        noise=noises[0],
        non_negative=non_negative,
        tolerance=REFERENCE_TOLERANCE,
        on_progress=phases.of("reference"),
    ).image
    tuning = SyntheticTuning.of(support.projector, line, noises[0], reference, non_negative=non_negative)
    at_usual_beta = _best_sigma(
        tuning, noises, usual_beta, SIGMA_FACTORS, None, phases.descent("sigma", TUNING_ITERATIONS)
    )
    if not open_beta:
        return SigmaAndBeta(
            NoiseMultiple(at_usual_beta.factor), usual_beta, support.embedded(at_usual_beta.images[:1])[0]
        )
    betas = usual_beta * BETA_STEPS
    on_beta, near, pairs = phases.of("beta"), at_usual_beta.images, list[_BestSigma]()
    for one, step in zip(betas, BETA_STEPS, strict=True):
        part = part_of(on_beta, len(pairs) / betas.size, 1.0 / betas.size)
        # Around the sigma that the best one at the usual beta predicts.
        sigmas = at_usual_beta.factor * step**SIGMA_POWER * NEAR_FACTORS
        pairs.append(_best_sigma(tuning, noises, one, sigmas, near, counting_iterations(part, TUNING_ITERATIONS)))
    factors = np.array([pair.factor for pair in pairs])
    validation = cross_validate(
        Objective(support.projector, problem.lines, _weights(factors, noises, problem.lines), _prior(betas)),
        noises[0],
        smooth.images,
        exponent=EDGE_EXPONENT,
        iterations=VALIDATION_ITERATIONS,
        non_negative=non_negative,
        on_progress=phases.of("validation"),
    )
    penalty = STEP_PENALTY * np.abs(np.log(BETA_STEPS))
    errors = np.array([pair.error for pair in pairs]) + VALIDATION_WEIGHT * np.log(validation.in_views) + penalty
    best_beta, _ = parabola_minimum(betas, errors)
    factor = math.exp(np.interp(math.log(best_beta), np.log(betas), np.log(factors)))
    return SigmaAndBeta(NoiseMultiple(factor), best_beta, support.embedded(pairs[np.argmin(errors)].images[:1])[0])


class _BestSigma(NamedTuple):
    """The best sigma for a beta, as a multiple of the noise, its error and its images (2, n, n)."""

    factor: float
    error: float
    images: Images


def _best_sigma(
    tuning: SyntheticTuning,
    noises: Floats,
    beta: float,
    factors: Floats,
    start: Images | None,
    on_iteration: OnIteration,
) -> _BestSigma:
    weights = _weights(factors, noises, tuning.lines[:1])
    errors, images = tuning.errors(weights, _prior(np.full(factors.size, beta)), start, on_iteration)
    return _BestSigma(*parabola_minimum(factors, errors), images[np.argmin(errors)])


def _weights(factors: Floats, noises: Floats, lines: Images) -> Images:
    """Return 1 / sigma^2 for multiples of the noise, (factors, views, detector)."""
    return weights_of(factors[:, None, None] * noises, (factors.size, *lines.shape[1:]))


def _prior(betas: Floats, corner: float | None = None) -> CauchyPrior:
    return CauchyPrior(betas, np.full(betas.shape, STRENGTH), betas if corner is None else np.full(betas.shape, corner))


def _settings(
    problem: PriorProblem, sigma: ArrayLike | NoiseMultiple | None, beta: float | None, corner: float | None
) -> Settings:
    if isinstance(sigma, NoiseMultiple):
        sigmas = sigma.factor * problem.noises
    else:
        sigmas = noise_of_each_ray(sigma, problem.lines)
        left_out = ~np.isfinite(problem.noises)
        sigmas = np.where(left_out, np.inf, sigmas) if left_out.any() else sigmas
    betas = _betas(beta, problem)
    return Settings(sigmas, _prior(betas, corner), {"sigma": np.array([rms_noise(sigmas)]), "beta": betas})


def _betas(beta: float | None, problem: PriorProblem) -> Floats:
    """Return the scale for each slice: the given one, or a share of its typical attenuation."""
    if beta is not None:
        if not (np.isfinite(beta) and beta > 0.0):
            raise GeometryError(f"beta must be a positive attenuation, not {beta}")
        return np.full(len(problem.lines), float(beta))
    return BETA_SHARE / math.sqrt(problem.support.projector.grid.size) * typical_attenuation(problem.first_images)


@dataclass(frozen=True)
class CauchyMap(FittedMethod):
    """The method `cauchy_map` in the table of methods."""

    least_images: ClassVar[int] = IMAGES_OF_A_DESCENT * CANDIDATES_AT_ONCE
    pairs_a_slice: ClassVar[float] = USUAL_PAIRS
    choosing_cost_slices: ClassVar[float] = 16.0
    leaves_out: ClassVar[bool] = True

    sigma: float | NoiseMultiple | None = None
    beta: float | None = None
    preset: Literal["paper"] | None = None
    non_negative: bool = True

    @property
    def is_open(self) -> bool:
        """True if sigma is to be chosen, together with beta."""
        return self.sigma is None and self.preset is None

    def chosen(self, projector: Projector, line: Image, *, noise: FloatArray, on_progress: OnProgress) -> Self:
        """Return the method with the sigma, a multiple of the noise, and the beta chosen for one slice."""
        choice = choose_sigma_and_beta(
            projector, line, beta=self.beta, noise=noise, non_negative=self.non_negative, on_progress=on_progress
        )
        return replace(self, sigma=choice.sigma, beta=choice.beta)

    @property
    def choice(self) -> dict[str, float]:
        """Sigma as a multiple of the noise, and beta."""
        if not isinstance(self.sigma, NoiseMultiple) or self.beta is None:
            return {}
        return {"noise_multiple": float(self.sigma.factor), "beta": float(self.beta)}

    def with_choice(self, choice: Mapping[str, float]) -> Self:
        """Return the method with a chosen sigma and beta."""
        return replace(self, sigma=NoiseMultiple(choice["noise_multiple"]), beta=choice["beta"])

    def reconstruct(
        self, projector: Projector, lines: Image, *, noise: FloatArray, on_progress: OnProgress
    ) -> Estimate:
        """Reconstruct a block."""
        return cauchy_map(projector, lines, **vars(self), noise=noise, on_progress=on_progress)
