"""u_c and tau from the log next to the phantom (docs/understand/verdict.md#a-log-beside-the-phantom).

The phantom's rows and, by opposite rays or pairs of views, the log's rows give u_c and tau independently. Answers that
agree are combined by their covariances. Where the answers disagree, the body that moved during the scan decides which
answer is used.
"""

import math
from dataclasses import dataclass

import numpy as np

from sawmill_tomography.drift.change import LogMovement
from sawmill_tomography.drift.detector_fit import BY_CHANCE
from sawmill_tomography.geometry.fit_parameters import FitParameter
from sawmill_tomography.geometry.geometry import FloatArray, Scanner, SourceFrame, to_vector
from sawmill_tomography.geometry.ray_error import predicted_ray_error
from sawmill_vocabulary import Agreement, DetectorEstimate, MovedBody, Rotation, UsedEstimate

# Chi-squared, 2 degrees of freedom: 99.9 % of agreeing pairs are below. Between `BY_CHANCE` and this the answers are
# combined, and the errors enlarged by the difference (Birge 1932).
DISAGREE = 13.816
# `LogWitness.vector`, `covariance` and `kept`.
_Conditioned = tuple[FloatArray, FloatArray, FloatArray]
# The parameters that both bodies show.
BOTH = [FitParameter.U_C, FitParameter.TILT]


@dataclass(frozen=True, eq=False)
class LogAnswer:
    """The log's measurement of u_c and tau at the phantom's SDD."""

    detector: DetectorEstimate
    sdd_sensitivity: FloatArray  # (2,): change of u_c and tau per mm of SDD
    rotation: Rotation  # the sense in which the log turned; the calibrated sense where the log does not show the sense
    movement: LogMovement | None  # None where the scan has too few views to show whether the log moved


@dataclass(frozen=True, eq=False)
class LogWitness:
    """The answers of the log and the phantom, and the geometry that follows."""

    log: LogAnswer
    other_sense: bool  # the log turned in the other sense than the phantom's fit: the log is then not used
    phantom: DetectorEstimate  # u_c and tau of the phantom's rows alone
    difference: DetectorEstimate  # u_c and tau of the log less u_c and tau of the phantom
    chi_squared: float  # chi-squared of the difference, with 2 degrees of freedom
    ray_change_mm: float  # RMS distance by which the difference moves the rays in the log's disc
    agreement: Agreement
    # The body that moved during the scan, where the scan shows it. A log that moved is not used.
    moved: MovedBody | None
    taken: UsedEstimate  # the body or bodies whose u_c and tau are reported
    vector: FloatArray  # (5,): the geometry (psi, R, SDD, u_c, tau) that follows from both answers
    covariance: FloatArray  # (5, 5)
    kept: FloatArray  # (5, 5): what remains of the phantom's errors; the rest of the covariance is by the log

    @property
    def reported(self) -> DetectorEstimate:
        """Reported u_c and tau."""
        return _detector(self.vector, self.covariance)


def compare_witnesses(
    scanner: Scanner,
    frame: SourceFrame,
    covariance: FloatArray,
    log: LogAnswer,
    rotation: Rotation,
    *,
    phantom_moved: bool,
    radius_mm: float,
) -> LogWitness:
    """Compare the log's answer with the phantom's, and combine or select the two."""
    vector = to_vector(frame)
    sees = np.zeros((2, len(vector)))
    sees[[0, 1], BOTH] = 1.0
    difference = log.detector.values - vector[BOTH]
    # At another SDD the log gives another u_c and tau.
    sees[:, FitParameter.SDD] = -log.sdd_sensitivity
    spread = sees @ covariance @ sees.T + log.detector.covariance
    chi_squared = float(difference @ np.linalg.solve(spread, difference))
    agreement = _agreement(chi_squared)
    moved = _moved(log.movement, agreement, phantom_moved=phantom_moved)
    other_sense = log.rotation is not rotation
    taken = _taken(moved, usable=not (other_sense or (moved is None and agreement is Agreement.DISAGREE)))
    prior = _Prior(vector, covariance, sees)
    match taken:
        case "phantom":
            conditioned = vector, covariance, np.eye(len(vector))
        case "log":
            conditioned = prior.replaced(difference, np.array(log.detector.covariance))
        case "both":
            conditioned = prior.combined(
                difference, np.array(log.detector.covariance), max(1.0, chi_squared / BY_CHANCE)
            )
    bias = np.zeros((len(vector), 1))
    bias[BOTH, 0] = difference
    return LogWitness(
        log,
        other_sense,
        _detector(vector, covariance),
        DetectorEstimate.of(difference, spread),
        chi_squared,
        predicted_ray_error(scanner, frame, bias @ bias.T, radius_mm=radius_mm).rms_mm,
        agreement,
        moved,
        taken,
        *_with_theta(scanner, *conditioned),
    )


def _detector(vector: FloatArray, covariance: FloatArray) -> DetectorEstimate:
    return DetectorEstimate.of(vector[BOTH], covariance[np.ix_(BOTH, BOTH)])


def _agreement(chi_squared: float) -> Agreement:
    if chi_squared > DISAGREE:
        return Agreement.DISAGREE
    return Agreement.AGREE if chi_squared <= BY_CHANCE else Agreement.STRAINED


def _moved(log: LogMovement | None, agreement: Agreement, *, phantom_moved: bool) -> MovedBody | None:
    """Return the body that moved: a log whose opposite rays agree did not, so the phantom did if the answers differ."""
    if log is None:
        return MovedBody.PHANTOM if phantom_moved and agreement is Agreement.DISAGREE else None
    if log.beyond_chance:
        return MovedBody.BOTH if phantom_moved else MovedBody.LOG
    return MovedBody.PHANTOM if agreement is Agreement.DISAGREE else None


def _taken(moved: MovedBody | None, *, usable: bool) -> UsedEstimate:
    if not usable or moved in {MovedBody.LOG, MovedBody.BOTH}:
        return "phantom"
    return "both" if moved is None else "log"


@dataclass(frozen=True, eq=False)
class _Prior:
    """The phantom's answer and covariance, and the derivative of the log's answer by the phantom's, (2, 5)."""

    vector: FloatArray
    covariance: FloatArray
    sees: FloatArray

    def combined(self, difference: FloatArray, log_covariance: FloatArray, widened: float) -> _Conditioned:
        """Combine both answers by linear least squares (Kalman 1960), all variances enlarged by `widened`."""
        cross = self.covariance @ self.sees.T
        gain = cross @ np.linalg.inv(self.sees @ cross + log_covariance)
        kept = math.sqrt(widened) * (np.eye(len(gain)) - gain @ self.sees)
        return self.vector + gain @ difference, widened * (self.covariance - gain @ cross.T), kept

    def replaced(self, difference: FloatArray, log_covariance: FloatArray) -> _Conditioned:
        """Use the log's u_c and tau, and the phantom's rows for the rest of the geometry with these two known.

        The error of the phantom's u_c and tau shows that its error bars are too small by a factor: the covariance of
        the rest is enlarged by the square of this factor.
        """
        cross = self.covariance @ self.sees.T
        own = self.sees @ cross
        gain = cross @ np.linalg.inv(own)
        widened = max(1.0, float(difference @ np.linalg.solve(own, difference)) / 2.0)
        rest = widened * (self.covariance - gain @ cross.T)
        kept = math.sqrt(widened) * (np.eye(len(gain)) - gain @ self.sees)
        return self.vector + gain @ difference, rest + gain @ log_covariance @ gain.T, kept


def _with_theta(scanner: Scanner, vector: FloatArray, covariance: FloatArray, kept: FloatArray) -> _Conditioned:
    """Hold R at r_S where R became less, since no theta exists there, as `source_distance.with_theta` does."""
    deficit = scanner.source_to_cor_mm - vector[FitParameter.R]
    variance = covariance[FitParameter.R, FitParameter.R]
    if deficit <= 0.0 or variance == 0.0:
        return vector, covariance, kept
    step = covariance[:, FitParameter.R] * (deficit / variance)
    moved = vector + step
    moved[FitParameter.R] = scanner.source_to_cor_mm
    return moved, covariance + np.outer(step, step), kept
