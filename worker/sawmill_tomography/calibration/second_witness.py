"""The log beside the phantom as a second witness for u_c and tau (docs/geometry.md#a-second-witness).

The phantom's rows and, by opposite rays or pairs of views, the log's rows give u_c and tau independently. Answers that
agree are combined by their covariances; where they do not, what moved during the scan decides whose are taken.
"""

from dataclasses import dataclass

import numpy as np

from sawmill_tomography.calibration.fit_parameters import FitParameter
from sawmill_tomography.drift.change import LogMovement
from sawmill_tomography.geometry.geometry import FloatArray, Scanner, SourceFrame, to_vector
from sawmill_tomography.geometry.ray_error import predicted_ray_error
from sawmill_vocabulary import Agreement, MovedBody, Rotation, WitnessTaken

# Chi-squared, 2 degrees of freedom: of two that agree, 95 % are below the first and 99.9 % below the second. Between
# them the answers are combined and their errors widened by what they differ by (Birge 1932).
AGREE, DISAGREE = 5.991, 13.816
# What both see.
BOTH = [FitParameter.U_C, FitParameter.TILT]


@dataclass(frozen=True, eq=False)
class LogAnswer:
    """What the log gives at the phantom's SDD.

    Attributes
    ----------
    seen : (2,) float64
        u_c (mm) and tau (rad).
    covariance : (2, 2) float64
    sdd_sensitivity : (2,) float64
        Change of the two per mm of SDD.
    rotation : Rotation
        The sense in which the log turned; the calibrated one where the log does not tell.
    movement : LogMovement or None
        None where the scan does not show whether the log moved: of few views.
    """

    seen: FloatArray
    covariance: FloatArray
    sdd_sensitivity: FloatArray
    rotation: Rotation
    movement: LogMovement | None


@dataclass(frozen=True, eq=False)
class LogWitness:
    """Both answers, and what follows.

    Attributes
    ----------
    log : LogAnswer
    other_sense : bool
        The log turned the other way than the phantom is explained by: then it is not heard.
    phantom_seen, phantom_covariance : (2,), (2, 2) float64
        u_c and tau of the phantom's rows alone.
    difference, difference_covariance : (2,), (2, 2) float64
        The log's less the phantom's.
    chi_squared : float
        Of the difference, with 2 degrees of freedom.
    ray_change_mm : float
        RMS distance that the difference makes to the rays in the log's disc.
    agreement : Agreement
    moved : MovedBody or None
        Which body moved during the scan, where one did and the scan tells which. A log that moved is not heard.
    taken : WitnessTaken
        Whose u_c and tau are reported.
    vector, covariance : (5,), (5, 5) float64
        The geometry (psi, R, SDD, u_c, tau) that follows from both.
    """

    log: LogAnswer
    other_sense: bool
    phantom_seen: FloatArray
    phantom_covariance: FloatArray
    difference: FloatArray
    difference_covariance: FloatArray
    chi_squared: float
    ray_change_mm: float
    agreement: Agreement
    moved: MovedBody | None
    taken: WitnessTaken
    vector: FloatArray
    covariance: FloatArray

    @property
    def reported(self) -> FloatArray:
        """The u_c and tau that follow, (2,)."""
        return self.vector[BOTH]

    @property
    def reported_covariance(self) -> FloatArray:
        """Of them, (2, 2)."""
        return self.covariance[np.ix_(BOTH, BOTH)]


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
    """Compare the log's answer with the phantom's, and take from each what it knows.

    Parameters
    ----------
    frame, covariance : SourceFrame, (5, 5) float64
        Of the phantom's rows alone.
    phantom_moved : bool
        Whether the phantom's fit found that it moved during the scan.
    radius_mm : float
        Of the disc in which rays are compared.
    """
    vector = to_vector(frame)
    sees = np.zeros((2, len(vector)))
    sees[[0, 1], BOTH] = 1.0
    difference = log.seen - vector[BOTH]
    # At another SDD the log gives another u_c and tau.
    sees[:, FitParameter.SDD] = -log.sdd_sensitivity
    spread = sees @ covariance @ sees.T + log.covariance
    chi_squared = float(difference @ np.linalg.solve(spread, difference))
    agreement = _agreement(chi_squared)
    moved = _moved(log.movement, agreement, phantom_moved=phantom_moved)
    other_sense = log.rotation is not rotation
    undecided = moved is None and agreement is Agreement.DISAGREE
    taken = _taken(moved, heard=not (other_sense or undecided))
    prior = _Prior(vector, covariance, sees)
    match taken:
        case "phantom":
            conditioned = vector, covariance
        case "log":
            conditioned = prior.replaced(difference, log.covariance)
        case "both":
            conditioned = prior.combined(difference, log.covariance, max(1.0, chi_squared / AGREE))
    bias = np.zeros((len(vector), 1))
    bias[BOTH, 0] = difference
    change = predicted_ray_error(scanner, frame, bias @ bias.T, radius_mm=radius_mm)
    return LogWitness(
        log,
        other_sense,
        vector[BOTH],
        covariance[np.ix_(BOTH, BOTH)],
        difference,
        spread,
        chi_squared,
        change.rms_mm,
        agreement,
        moved,
        taken,
        *_with_theta(scanner, *conditioned),
    )


def _agreement(chi_squared: float) -> Agreement:
    if chi_squared > DISAGREE:
        return Agreement.DISAGREE
    return Agreement.AGREE if chi_squared <= AGREE else Agreement.STRAINED


def _moved(log: LogMovement | None, agreement: Agreement, *, phantom_moved: bool) -> MovedBody | None:
    """A log whose opposite rays agree with each other stood still: where the answers differ, the phantom moved."""
    if log is None:
        return MovedBody.PHANTOM if phantom_moved and agreement is Agreement.DISAGREE else None
    if log.beyond_chance:
        return MovedBody.BOTH if phantom_moved else MovedBody.LOG
    return MovedBody.PHANTOM if agreement is Agreement.DISAGREE else None


def _taken(moved: MovedBody | None, *, heard: bool) -> WitnessTaken:
    if not heard or moved in {MovedBody.LOG, MovedBody.BOTH}:
        return "phantom"
    return "both" if moved is None else "log"


@dataclass(frozen=True, eq=False)
class _Prior:
    """The phantom's answer and its covariance, and how the log's answer depends on it, (2, 5)."""

    vector: FloatArray
    covariance: FloatArray
    sees: FloatArray

    def combined(
        self, difference: FloatArray, log_covariance: FloatArray, widened: float
    ) -> tuple[FloatArray, FloatArray]:
        """The linear least squares of both (Kalman 1960), all variances widened by a factor."""
        cross = self.covariance @ self.sees.T
        gain = cross @ np.linalg.inv(self.sees @ cross + log_covariance)
        return self.vector + gain @ difference, widened * (self.covariance - gain @ cross.T)

    def replaced(self, difference: FloatArray, log_covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The log's u_c and tau, and the rest as the phantom's rows give it with these two known.

        The phantom's error bars are too small by what its u_c and tau were off by, so the rest is widened by it.
        """
        cross = self.covariance @ self.sees.T
        own = self.sees @ cross
        gain = cross @ np.linalg.inv(own)
        widened = max(1.0, float(difference @ np.linalg.solve(own, difference)) / 2.0)
        rest = widened * (self.covariance - gain @ cross.T)
        return self.vector + gain @ difference, rest + gain @ log_covariance @ gain.T


def _with_theta(scanner: Scanner, vector: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Hold R at r_S where it came to be less, for which no theta exists, as `source_distance.with_theta` does."""
    deficit = scanner.source_to_cor_mm - vector[FitParameter.R]
    variance = covariance[FitParameter.R, FitParameter.R]
    if deficit <= 0.0 or variance == 0.0:
        return vector, covariance
    step = covariance[:, FitParameter.R] * (deficit / variance)
    moved = vector + step
    moved[FitParameter.R] = scanner.source_to_cor_mm
    return moved, covariance + np.outer(step, step)
