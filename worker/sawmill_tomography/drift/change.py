"""The change of the geometry since a calibration, its certainty and its cause: from a scan of any log, no phantom.

The fits are in `conjugate_rays` (dense scans) and `view_pairs` (any scan). R and psi cannot be seen
(docs/understand/drift.md).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from sawmill_tomography.geometry.contrast_loss import contrast_loss
from sawmill_tomography.geometry.fit_parameters import FitParameter
from sawmill_tomography.geometry.geometry import FloatArray, GeometryError, Scanner, SourceFrame, to_vector
from sawmill_tomography.geometry.ray_error import predicted_ray_error, ray_error, scale_deviation
from sawmill_vocabulary import DetectorEstimate, Rotation
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.movement_messages import LogMessage
from sawmill_vocabulary.uncertainty import ContrastLoss

# The numbers of the geometry that a log's rays show, in the order of their vectors.
SEEN = [FitParameter.U_C, FitParameter.TILT, FitParameter.SDD]
# A change beyond this many standard deviations is significant.
SIGNIFICANT = 3.0
# A shorter jump is not reported (mm). An exact scan shows 0.001: tests/tomography/test_log_movement.py.
SHORTEST_JUMP_MM = 0.01
# Chi-squared, 2 degrees of freedom, that the best of several hundred views, each tried as the one after which the log
# lies elsewhere, reaches by chance in less than one of a thousand scans: tests/tomography/test_log_movement.py.
CHANCE_OF_A_JUMP = 30.0
# Chi-squared, 2 degrees of freedom, that a motion may leave unexplained with the same confidence.
UNEXPLAINED = 11.83

DISTANCE_NOT_SEEN = "the distance from source to detector: this log does not show it, so it is held at the known one"
FLAT_FIELD_NOT_SEEN = (
    "an error of the flat field behind the log that the air beside it does not show: with so few views it looks like a "
    "centre of rotation that moved"
)
FLAT_FIELD_CHANGE_NOT_SEEN = (
    "an error of the flat field behind the log that is newer than the baseline and that the air beside the log does "
    "not show: with so few views it looks like a centre of rotation that moved"
)
ENCODER_NOT_SEEN = (
    "an encoder that is wrong by far more than 0.1 degrees once a turn, or wrong twice a turn: with so few views it "
    "looks like a centre of rotation that moved, one way or the other as the log lies, and cancels over many logs"
)
NOT_SEEN = (
    "the distance R from the source to the centre of rotation: only the phantom's known size gives the scale",
    "the first angle psi, so neither the encoder's zero nor which way is up",
    "from which end the log is looked at",
    "a turntable that moved along the ray through the centre of rotation, which changes R alone",
)


class DriftError(ValueError):
    """A scan that shows no drift; the message gives the reason.

    `code`, for programs, is stable: sparse-views, partial-turn, log-cut-off, outside-detector, nothing-seen,
    moved-too-far, metal-in-log, turned-between-passages.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True)
class LogMovement:
    """A jump of the log: the first view after the jump, its length, and its chi-squared of 2 degrees of freedom."""

    view: int
    by_mm: float
    chi_squared: float

    @property
    def beyond_chance(self) -> bool:
        """True if a log that did not move would hardly give this chi-squared."""
        return self.chi_squared > CHANCE_OF_A_JUMP and self.by_mm > SHORTEST_JUMP_MM


@dataclass(frozen=True)
class Disturbance:
    """A harmonic that disturbs the turn."""

    # "encoder": the angles run ahead and behind. "bearing": the log swings across the beam.
    part: Literal["encoder", "bearing"]
    order: int  # periods per turn


@dataclass(frozen=True, eq=False)
class DetectorFit:
    """The detector's geometry as a log's rays show it: opposite rays of a dense scan, or pairs of views of any scan."""

    cor_column_mm: float
    tilt_rad: float
    source_to_detector_mm: float
    covariance: FloatArray  # (3, 3): covariance of (u_c, tau, SDD)
    # The scan does not show SDD, which stayed at the calibrated one; its row of the covariance is zero
    distance_held: bool
    rotation: Rotation  # the sense of rotation in which the rays agree better
    rotation_ratio: float  # residual of the other sense divided by this sense's residual
    rotation_decided: bool  # True if the scan shows in which sense it turned; a round, centred log does not
    # RMS of the differences divided by the RMS of the compared signal: for opposite rays its part that changes with the
    # view, after the blur; for pairs of views their sums
    relative_residual: float
    # (2,): change of (u_c, tau) per mm of the SDD at which they were fitted; zeros where SDD was fitted too
    distance_sensitivity: FloatArray
    adjustments: tuple[str, ...]  # changes made to the scan before the fit
    # Disturbances of the turn beyond chance, fitted with the geometry: each one's amplitude in its unit
    disturbances: Mapping[Disturbance, float] = field(default_factory=dict)
    # Largest change of this log's u_c by an encoder that is wrong by 0.1 degrees once a turn; the covariance allows for
    # this change. None where the encoder's error is fitted as a disturbance.
    encoder_bound_mm: float | None = None
    # The jump of the log that explains most of what opposite rays leave, beyond chance or not; None without them
    movement: LogMovement | None = None

    @property
    def deviation(self) -> FloatArray:
        """Standard deviations of (u_c, tau, SDD)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def sdd_sensitivity(self) -> FloatArray:
        """Change of (u_c, tau) per mm of SDD, (2,), whether SDD was held or fitted."""
        if self.distance_held:
            return self.distance_sensitivity
        return np.asarray(self.covariance[:2, 2] / self.covariance[2, 2])

    def at_distance(self, source_to_detector_mm: float) -> DetectorEstimate:
        """Return u_c and tau as they follow for a known SDD."""
        values = seen_vector(self)[:2] + self.sdd_sensitivity * (source_to_detector_mm - self.source_to_detector_mm)
        return DetectorEstimate.of(
            values, self.covariance[:2, :2] - np.outer(self.sdd_sensitivity, self.covariance[2, :2])
        )


@dataclass(frozen=True, eq=False)
class ConjugateFit(DetectorFit):
    """A fit to opposite rays, which show whether the log moved."""


@dataclass(frozen=True, eq=False)
class DriftChange:
    """Measured geometry less the calibrated one or less a baseline."""

    change: FloatArray  # (3,): change of (u_c, tau, SDD)
    covariance: FloatArray  # (3, 3): covariance of the change: this scan's, and the calibration's or the baseline's
    # RMS distance of the rays inside the log's disc with R and psi held, a common scale removed; SDD is held too where
    # it has not changed significantly, because this scan shows SDD less well than the calibration does
    ray_change_mm: float
    ray_change_uncertainty_mm: float  # RMS ray distance that the covariance alone causes
    # The common scale as a share, and its standard deviation: the effect of a changed SDD on the image's size
    scale_change: float
    scale_deviation: float
    contrast_loss: ContrastLoss

    @property
    def deviation(self) -> FloatArray:
        """Standard deviations of the changes, (3,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def significance(self) -> FloatArray:
        """Changes in units of their standard deviations, (3,); 0 for a value that was held."""
        deviation = self.deviation
        return np.divide(self.change, deviation, out=np.zeros(3), where=deviation > 0.0)

    @property
    def moved(self) -> bool:
        """True if any change is significant."""
        return bool(np.any(np.abs(self.significance) > SIGNIFICANT))


def seen_vector(value: "SourceFrame | DetectorFit") -> FloatArray:
    """Return the numbers that a log's rays show, (3,): u_c, tau, SDD, in the order of `SEEN`."""
    return np.array([value.cor_column_mm, value.tilt_rad, value.source_to_detector_mm])


def better_sense(residual: Mapping[Rotation, float], calibrated: Rotation, decisive: float) -> tuple[Rotation, float]:
    """Return the sense of rotation in which a scan agrees better, and the other sense's residual divided by its own.

    The calibrated sense is kept, perhaps with a ratio below 1, unless the other sense's residual is smaller by the
    factor `decisive`.
    """
    other = next(sense for sense in Rotation if sense is not calibrated)
    ratio = residual[other] / residual[calibrated]
    return (other, 1.0 / ratio) if ratio < 1.0 / decisive else (calibrated, ratio)


def drift_change(
    scanner: Scanner,
    calibrated: SourceFrame,
    calibrated_covariance: FloatArray | None,
    fit: DetectorFit,
    *,
    zero: DetectorEstimate | None = None,
    radius_mm: float = 150.0,
) -> DriftChange:
    """Compare the fit to a scan of a log with a calibration, or with a baseline.

    Parameters
    ----------
    calibrated_covariance : (5, 5) float64
        Covariance of (psi, R, SDD, u_c, tau); None where the calibration has no error bars, which then count as zero.
    zero : DetectorEstimate
        A baseline's change since this calibration; the change of u_c and tau is counted from the baseline.
    radius_mm : float
        Radius of the disc in which rays are compared.
    """
    change, covariance = seen_vector(fit) - seen_vector(calibrated), fit.covariance.copy()
    if zero is not None:
        # An error of the held SDD is in the baseline's drift checks too, and cancels in the difference.
        change[:2] -= zero.values
        covariance[:2, :2] += zero.covariance
        covariance[2, 2] += 0.0 if calibrated_covariance is None else calibrated_covariance[SEEN[2], SEEN[2]]
    elif calibrated_covariance is not None:
        # Where SDD is held, the calibration's error of SDD changes the measured u_c and tau.
        difference = np.eye(3)
        difference[:2, 2] = -fit.distance_sensitivity
        covariance += difference @ calibrated_covariance[np.ix_(SEEN, SEEN)] @ difference.T
    if fit.distance_held:
        covariance[2, :] = covariance[:, 2] = 0.0
    counted, spread = _counted(change, covariance)
    u_c, tau, sdd = (float(value) for value in seen_vector(calibrated) + counted)
    moved_frame = replace(calibrated, cor_column_mm=u_c, tilt_rad=tau, source_to_detector_mm=sdd)
    frame_covariance = np.zeros((5, 5))
    frame_covariance[np.ix_(SEEN, SEEN)] = spread
    rays, scale, lost = _moved_rays(scanner, calibrated, moved_frame, radius_mm)
    uncertainty = predicted_ray_error(scanner, moved_frame, frame_covariance, radius_mm=radius_mm).rms_mm
    of_scale = scale_deviation(scanner, moved_frame, frame_covariance, radius_mm=radius_mm)
    return DriftChange(change, covariance, rays, uncertainty, scale, of_scale, lost)


def zero_offset_mm(scanner: Scanner, calibrated: SourceFrame, zero: DetectorEstimate, *, radius_mm: float) -> float:
    """Return the RMS distance of the rays between a baseline and the calibration, with R, psi and SDD held."""
    u_c, tau = (float(value) for value in seen_vector(calibrated)[:2] + zero.values)
    return _moved_rays(scanner, calibrated, replace(calibrated, cor_column_mm=u_c, tilt_rad=tau), radius_mm)[0]


def _moved_rays(
    scanner: Scanner, calibrated: SourceFrame, moved: SourceFrame, radius_mm: float
) -> tuple[float, float, ContrastLoss]:
    """Return the RMS distance of the rays in mm, the common scale that is removed, as a share, and what images lose."""
    try:
        error = ray_error(scanner, calibrated, moved, radius_mm=radius_mm)
    except GeometryError:  # the calibrated rays no longer meet the log
        return radius_mm, 0.0, ContrastLoss(100.0, 100.0)
    lost = contrast_loss(scanner, calibrated, to_vector(moved) - to_vector(calibrated), radius_mm=radius_mm)
    return error.rms_mm, error.scale_change, lost


def _counted(change: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the change and its covariance, conditional on an unchanged SDD unless SDD has changed significantly."""
    if covariance[2, 2] == 0.0 or abs(change[2]) > SIGNIFICANT * math.sqrt(covariance[2, 2]):
        return change, covariance
    distance_sensitivity = covariance[:, 2] / covariance[2, 2]
    return change - distance_sensitivity * change[2], covariance - np.outer(distance_sensitivity, covariance[2])


def disturbed_turn(fit: DetectorFit) -> tuple[Reason, ...]:
    """Return what disturbs the turn beyond chance, and what to check."""
    times = {1: "once", 2: "twice"}
    return tuple(
        LogMessage.ENCODER(encoder_deg=size, times=times[each.order])
        if each.part == "encoder"
        else LogMessage.BEARING(bearing_mm=size, times=times[each.order])
        for each, size in fit.disturbances.items()
    )


def likely_cause(calibrated: SourceFrame, moved: DriftChange) -> Reason:
    """Return what moved and what to check.

    A turntable that moves leaves the detector's foot u_n = u_c - SDD sin tau and height H = SDD cos tau as they are, so
    tau and SDD follow u_c; a detector that slides along itself leaves tau and SDD as they are.
    """
    column, tilt, distance = (float(value) for value in moved.change)
    tau = calibrated.tilt_rad
    if not moved.moved:
        column_error, tilt_error = (float(value) for value in moved.deviation[:2])
        return LogMessage.NOTHING_MOVED(column_error_mm=column_error, tilt_error_deg=math.degrees(tilt_error))
    turntable = _unexplained(moved, np.array([1.0, math.cos(tau) / calibrated.source_to_detector_mm, math.sin(tau)]))
    slide = _unexplained(moved, np.array([1.0, 0.0, 0.0]))
    if turntable <= UNEXPLAINED and not abs(moved.significance[1]) > SIGNIFICANT:
        either = LogMessage.TURNTABLE_OR_STOPS if slide <= UNEXPLAINED else LogMessage.TURNTABLE
        return either(column_mm=column)
    if turntable <= UNEXPLAINED:
        return LogMessage.TURNTABLE_SIDEWAYS(column_mm=column)
    if slide <= UNEXPLAINED:
        return LogMessage.DETECTOR_SLID(column_mm=column)
    return LogMessage.MOUNTING(column_mm=column, tilt_deg=math.degrees(tilt), distance_mm=distance)


def _unexplained(moved: DriftChange, direction: FloatArray) -> float:
    """Return the chi-squared of the change after the best multiple of a motion is subtracted."""
    seen = np.flatnonzero(moved.deviation > 0.0)
    precision = np.zeros((3, 3))
    precision[np.ix_(seen, seen)] = np.linalg.inv(moved.covariance[np.ix_(seen, seen)])
    rest = moved.change - float(direction @ precision @ moved.change / (direction @ precision @ direction)) * direction
    return float(rest @ precision @ rest)
