"""The residual compared with white noise, and the error bars: the covariance and the predicted ray error."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from sawmill_tomography.calibration.covariance import Covariance, frame_deviation, theta_covariance
from sawmill_tomography.calibration.joint_fit.groups import ON_DETECTOR
from sawmill_tomography.calibration.joint_fit.joint_fit import JointFit
from sawmill_tomography.calibration.joint_fit.modules import HiddenModule
from sawmill_tomography.calibration.joint_fit.normal_equations import SINGULAR
from sawmill_tomography.calibration.joint_fit.scan_model import (
    arc_term,
    gap_term,
    is_of_detector,
    kink_term,
    wave_terms,
)
from sawmill_tomography.calibration.joint_fit.selection import BEYOND_CHANCE, chance_limit
from sawmill_tomography.calibration.refusals import CalibrationError
from sawmill_tomography.geometry.detector_shape import FIRST_WAVE
from sawmill_tomography.geometry.fit_parameters import FRAME, RAYS, FitParameter
from sawmill_tomography.geometry.geometry import FloatArray, Scanner, SourceFrame, Theta
from sawmill_tomography.geometry.ray_error import (
    DRAWS,
    RayAlternatives,
    RayErrorMixture,
    RayErrorPrediction,
    ViewErrors,
    predicted_ray_error,
)

# An error of the model turns with the phantom, so it shows in the slowest harmonics of the views' scores. Two harmonics
# are enough for a measurement, and few enough to be close to the mean itself.
HARMONICS = 2
RAY_PARAMETERS = list(FitParameter)[RAYS]


@dataclass(frozen=True)
class ResidualStatistics:
    """Statistics of the residual, and the covariance that the residual warrants."""

    covariance: Covariance  # covariance of the seven unknowns, inflated by what the residual has beyond white noise
    ray_covariance: FloatArray  # (5 + 2 modules, 5 + 2 modules), with the places of cells where they are fitted
    parts: dict[str, FloatArray]  # by the names of `SOURCES`, which add up to `ray_covariance`
    hidden_modules: tuple[RayAlternatives, ...]
    mixture: RayErrorMixture | None  # all that may be real instead of what was fitted
    further_mm: float  # RMS ray error by what the detector's cells have beyond the waves that are fitted
    noise: float  # standard deviation of a sample
    inflation: float  # factor by which correlation within the views inflates the covariance; 1 for white noise
    deviation_ratio: float
    structured: bool  # True if the residual is more than white noise


@dataclass(frozen=True)
class _Scores:
    """Scores of the views (views, unknowns), sorted by angle, for unknowns whose Gram matrix is 1.

    A score is derivative times residual. The information that stripes take belongs to no single view, so it is not
    subtracted from this Gram matrix. `unscale` is (all unknowns, unknowns).
    """

    white: FloatArray
    unscale: FloatArray


def residual_statistics(joint: JointFit) -> ResidualStatistics:
    """Compute the residual's statistics, and the covariance that the residual warrants.

    Four things inflate the covariance:

    - Structure in the residual: each parameter takes one share by chance, as an effect on the detector does.
    - Residuals that are correlated within a view: the views' scores are compared with the scores of independent cells,
      by the mean eigenvalue of the cluster-robust covariance against the classical one (Liang and Zeger 1986).
    - Residuals that continue from view to view, as with a wrong drawing or a knot: the power of the scores' slowest
      harmonics over the turn is added as the covariance of the scores' mean (a long-run variance; Newey and West 1987
      with the periodogram's lowest ordinates as the kernel).
    - Effects that the scan shows and that must not be fitted: the bias of each.
    """
    _refuse_undetermined(joint)
    scores = _scores(joint)
    views, unknowns = scores.white.shape
    # The parameters, and the places of the detector's cells, by their places among the used columns.
    columns = [joint.system.columns[place] for place in joint.used]
    free = {column.parameter: n for n, column in enumerate(columns) if column.parameter is not None}
    modules = {column.term: n for n, column in enumerate(columns) if is_of_detector(column.term)}
    own, noise, count = [*free.values(), *modules.values()], joint.variance, len(free)
    plain = joint.system.inverse(joint.used)[np.ix_(own, own)] * noise
    of_free = plain
    parts = {source: part[np.ix_(own, own)] for source, part in _plain_parts(joint).items()}
    inflation, structured = 1.0, False
    if noise > 0.0:
        shared = max(joint.system.structured - float(joint.change @ joint.system.score), 0.0) / (ON_DETECTOR * noise)
        if views > unknowns:
            clustered = float((scores.white**2).sum()) * views / (views - unknowns) / (unknowns * noise)
            # The estimate scatters for white noise too.
            white = clustered * (views - unknowns) <= chance_limit(BEYOND_CHANCE, views - unknowns)
            inflation = 1.0 if white else clustered
        number = min(HARMONICS, (views - 1) // 2)
        waves = np.fft.rfft(scores.white, axis=0)[1 : number + 1]
        slow = float((np.abs(waves) ** 2).sum()) / (number * unknowns * noise)
        inflation = max(inflation, shared)
        structured = inflation > 1.0 or slow > chance_limit(BEYOND_CHANCE, waves.size * 2) / (waves.size * 2)
        of_free = plain * inflation
        parts["misfit-within-views"] = plain * (inflation - 1.0)
        if structured:
            # Student's t of the harmonics' two degrees of freedom each, against the normal distribution, at 97.5 %.
            wider = scipy.special.stdtrit(2 * number, 0.975) / scipy.special.ndtri(0.975)
            back = (waves @ scores.unscale.T)[:, own] * wider
            parts["misfit-between-views"] = np.real(back.conj().T @ back) / number
            of_free = of_free + parts["misfit-between-views"]
    if joint.biases:
        parts["effects-switched-off"] = np.sum([np.outer(bias[own], bias[own]) for bias in joint.biases], axis=0)
        of_free = of_free + parts["effects-switched-off"]
    values, names = np.zeros((len(FitParameter), len(FitParameter))), list(free)
    values[np.ix_(names, names)] = of_free[:count, :count]
    unknown = frozenset(p for p in free if not values[p, p] > 0.0)
    ratio = np.diag(of_free)[:count] / np.where(np.diag(plain) > 0.0, np.diag(plain), 1.0)[:count]
    return ResidualStatistics(
        Covariance(values, frozenset(FitParameter) - frozenset(free), unknown),
        *_of_rays(joint, [*free, *modules], own, of_free, parts),
        _beyond_waves_mm(joint),
        math.sqrt(noise),
        inflation,
        math.sqrt(float(ratio.mean())),
        structured,
    )


def _plain_parts(joint: JointFit) -> dict[str, FloatArray]:
    """Divide the covariance (used, used) for white noise by sources: noise, random effects, and sizes of effects."""
    used, system, patches = joint.used, joint.system, joint.system.patches
    of_used = None if patches is None else replace(patches, taken=patches.taken[:, used])
    scatter = system.source.scatter([system.columns[place] for place in used], of_used) + np.diag(joint.precision)
    inverse, normal = system.inverse(used), system.normal[np.ix_(used, used)]
    of_sources = {"noise": normal - scatter, "scatter": scatter}
    return {source: joint.variance * inverse @ part @ inverse for source, part in of_sources.items()}


def _of_rays(
    joint: JointFit,
    names: Sequence[int | None],
    own: Sequence[int],
    covariance: FloatArray,
    parts: dict[str, FloatArray],
) -> tuple[FloatArray, dict[str, FloatArray], tuple[RayAlternatives, ...], RayErrorMixture | None]:
    """Return `ray_covariance`, `parts`, `hidden_modules` and `mixture` from the covariance of the columns `own`."""
    order = terms_of_rays(joint)
    kept = [n for n, name in enumerate(names) if name in order]
    rows, columns = [order.index(name) for name in names if name in order], [own[n] for n in kept]
    every = np.zeros((1 + len(parts), len(order), len(order)))
    every[np.ix_(range(len(every)), rows, rows)] = np.stack([covariance, *parts.values()])[:, kept][:, :, kept]
    values, of_sources = every[0], dict(zip(parts, every[1:], strict=True))
    modules = tuple(_alternatives(group, columns, rows, len(order)) for group in joint.hidden_modules if group)
    drawn = joint.motion_sets.errors
    if drawn is None:
        return values, of_sources, modules, None
    errors = np.zeros((len(drawn), len(order)))
    errors[:, rows] = drawn[:, columns]
    return values, of_sources, modules, RayErrorMixture(errors, DRAWS)


def terms_of_rays(joint: JointFit) -> list[int]:
    """Return the terms that move the rays, in the order of `ResidualStatistics.ray_covariance`."""
    order = [*range(FRAME.stop)]
    for module in joint.modules:
        order += [gap_term(module.first_cell), kink_term(module.first_cell)]
    if any(joint.system.columns[place].term in joint.model.of_cells for place in joint.used):
        order += [arc_term(), *wave_terms()]
    return order


def _beyond_waves_mm(joint: JointFit) -> float:
    """Return the RMS ray error, mm, by waves shorter than the fitted ones, as in a random walk: k-th as 1 / k."""
    waves = joint.model.data.cells.waves_mm
    if not waves:
        return 0.0
    orders = np.arange(FIRST_WAVE, FIRST_WAVE + len(waves))
    last = slice(2 * len(waves) // 3, None)
    power = float(((orders[last] * np.array(waves)[last]) ** 2).mean())
    return math.sqrt(0.5 * power / (orders[-1] + 0.5)) / joint.model.frame.magnification


def _alternatives(
    group: Sequence[HiddenModule], columns: Sequence[int], rows: Sequence[int], size: int
) -> RayAlternatives:
    """Return the alternatives of a group, whose biases in these columns are errors in these rows of the order."""
    errors = np.zeros((len(group), size))
    errors[:, rows] = np.stack([one.bias for one in group])[:, columns]
    return RayAlternatives(
        first_cells=np.array([one.first_cell for one in group]),
        moves=np.array([(one.gap_mm, one.kink_rad) for one in group]),
        errors=errors,
        number=np.repeat(np.arange(len(group)), [one.factors.size for one in group]),
        factors=np.concatenate([one.factors for one in group]),
        probabilities=np.concatenate([one.probabilities for one in group]),
    )


def _refuse_undetermined(joint: JointFit) -> None:
    """Refuse a scan that does not determine the rays."""
    system, used = joint.system, joint.used
    free = [system.columns[place].parameter for place in used]
    scale = system.scale[used]
    values, vectors = np.linalg.eigh(system.normal[np.ix_(used, used)] * np.outer(scale, scale))
    lost = values <= SINGULAR * values[-1]
    of_rays = vectors[[place for place, p in enumerate(free) if p in RAY_PARAMETERS], :][:, lost]
    if (of_rays**2).sum() > math.sqrt(SINGULAR):  # beyond rounding
        raise CalibrationError(
            "too-few-views",
            f"the {system.views} views do not determine the geometry: other scanners would show the same; give "
            "more views, spread over the turn, or use a phantom with corners",
        )


def _scores(joint: JointFit) -> _Scores:
    system, used = joint.system, joint.used
    grams, scores = system.of_views(np.eye(len(system.columns))[:, used], joint.change)
    scores = scores[np.argsort(np.mod(joint.model.data.angles_rad, 2.0 * math.pi))]
    own = grams.sum(axis=0) + np.diag(joint.precision)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(own), 1e-300))
    values, vectors = np.linalg.eigh(own * np.outer(scale, scale))
    kept = values > SINGULAR * values[-1]
    root = vectors[:, kept] / np.sqrt(values[kept])
    return _Scores((scores * scale) @ root, scale[:, None] * root)


@dataclass(frozen=True, eq=False)
class ErrorBars:
    """Uncertainties of a calibration."""

    statistics: ResidualStatistics
    theta_covariance: FloatArray | None  # (5, 5); None where the source shift is not resolved from zero
    predicted_ray_error: RayErrorPrediction  # predicted ray error inside the log's disc

    @property
    def covariance(self) -> Covariance:
        """Covariance of the geometry's five unknowns."""
        return self.statistics.covariance.of_frame

    @property
    def theta_deviation(self) -> FloatArray | None:
        """Standard deviations of theta, (5,); None where theta has no covariance."""
        return None if self.theta_covariance is None else np.sqrt(np.diag(self.theta_covariance))

    def frame_deviation(self, frame: SourceFrame) -> FloatArray:
        """Compute standard deviations of (psi, R, SDD, u_c, tau, M), (6,); zero where held or unknown."""
        return frame_deviation(frame, self.covariance.values)


def error_bars(
    scanner: Scanner,
    frame: SourceFrame,
    theta: Theta,
    statistics: ResidualStatistics,
    radius_mm: float,
    of_views: ViewErrors | None = None,
    bound_times: float = 1.0,
) -> ErrorBars:
    """Compute the error bars from the residual's statistics, for rays inside a disc of this radius.

    `of_views` are the errors of views with poses of their own; `bound_times` is a factor of the bound.
    """
    predicted = predicted_ray_error(
        scanner,
        frame,
        statistics.ray_covariance,
        statistics.hidden_modules,
        statistics.mixture,
        radius_mm=radius_mm,
        further_mm=statistics.further_mm,
        of_views=of_views,
    )
    (low, high), upper_mm = predicted.interval_95_mm, bound_times * predicted.upper_95_mm
    predicted = replace(predicted, upper_95_mm=upper_mm, interval_95_mm=(low, bound_times * high))
    of_theta = theta_covariance(scanner, frame, theta, statistics.covariance.of_frame.values)
    return ErrorBars(statistics, of_theta, predicted)
