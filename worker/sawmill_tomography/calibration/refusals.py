"""Refusals of scans that cannot be calibrated, each with the reason and the cure, and their exception."""

from collections.abc import Callable

import numpy as np

from sawmill_tomography.calibration.fit import Fit
from sawmill_tomography.geometry.geometry import FloatArray, Scanner
from sawmill_tomography.phantoms.phantom import Phantom, PhantomError
from sawmill_tomography.sinograms.screening import FEWEST_VIEWS

# A fit that leaves more than this share of the sinogram unexplained has not found the phantom: the right phantom seen
# from the wrong side leaves 0.11 to 0.3, an empty scan 1.
NOT_FOUND = 0.25
# A source distance that differs from source_to_cor_mm by a larger factor is impossible: the fit diverged, or a unit is
# wrong.
FARTHEST = 2.0


class CalibrationError(Exception):
    """A failed calibration: this scan has none.

    `code`, for programs, is stable: other-detector, angles-mismatch, too-few-views, not-finite, flat-scan, no-geometry,
    phantom-outside-field, phantom-not-seen.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


def refuse_round(phantom: Phantom) -> None:
    """Refuse a phantom that looks the same from every side."""
    if phantom.is_round:
        raise PhantomError(
            f"the phantom {phantom.name!r} cannot calibrate: it looks the same from every side, so a scan shows "
            "neither its first angle nor from which end it was seen, and hardly how far the source is; use a phantom "
            "with corners, or with holes off its centre"
        )


def refuse_unusable(scanner: Scanner, sinogram: FloatArray, angles_rad: FloatArray) -> None:
    """Refuse data that do not belong together, or show nothing."""
    if sinogram.ndim != 2 or sinogram.shape[1] != scanner.num_detector_pixels:
        raise CalibrationError(
            "other-detector",
            f"the sinogram has shape {sinogram.shape}, but the scanner has {scanner.num_detector_pixels} "
            "detector cells: it must be (views, detector)",
        )
    if angles_rad.shape != sinogram.shape[:1]:
        raise CalibrationError(
            "angles-mismatch",
            f"there are {sinogram.shape[0]} views and {angles_rad.size} angles: each view needs its own",
        )
    if sinogram.shape[0] < FEWEST_VIEWS:
        raise CalibrationError(
            "too-few-views", f"{sinogram.shape[0]} views cannot calibrate: give at least {FEWEST_VIEWS}"
        )
    if not np.isfinite(sinogram).all() or not np.isfinite(angles_rad).all():
        raise CalibrationError("not-finite", "the sinogram or its angles hold NaN or infinite values: remove them")
    # Numbers below float32 are in no unit, and their squares would leave the range of float64.
    if 0.0 < np.ptp(sinogram) < np.finfo(np.float32).tiny:
        raise CalibrationError(
            "flat-scan",
            f"the values of the sinogram differ by {np.ptp(sinogram):.3g} at most: give line integrals in a unit "
            "in which they do not vanish",
        )
    if np.ptp(sinogram) == 0.0:
        raise CalibrationError(
            "flat-scan",
            f"every value of the sinogram is {sinogram[0, 0]:.6g}: nothing was scanned; check that the source was on, "
            "and which dataset and rows were read",
        )


def refuse_unfound(
    scanner: Scanner, phantom: Phantom, best: Fit | None, unexplained: float, likelier: Callable[[], str | None]
) -> None:
    """Refuse a scan that is not of this phantom: the best fit leaves the share `unexplained` of the sinogram.

    `likelier` looks for the name of another drawing, which explains the scan.
    """
    width = scanner.num_detector_pixels * scanner.detector_pitch_mm
    if unexplained > NOT_FOUND and 2.0 * phantom.radius_mm > width:
        raise CalibrationError(
            "phantom-outside-field",
            f"the phantom {phantom.name!r} reaches {phantom.radius_mm:.4g} mm from the centre of rotation, "
            f"and the detector is {width:.4g} mm wide: check the phantom's size or picture width, or use a smaller one",
        )
    if best is None or unexplained > NOT_FOUND:
        other = likelier()
        scanned = (
            f"the built-in drawing {other!r} explains the scan: was that phantom scanned? If not, " if other else ""
        )
        raise CalibrationError(
            "phantom-not-seen",
            f"the phantom {phantom.name!r} was not found: the best geometry leaves {unexplained:.0%} of the "
            f"sinogram unexplained; {scanned}check that the scan (and its rows) shows this phantom, its size, the "
            "angles and the scanner's constants",
        )


def refuse_other_scanner(scanner: Scanner, source_distance_mm: float) -> None:
    """Refuse a source distance of the free fit, all effects fitted, that is impossible for a scanner with this r_S.

    A fit without effects may have such an error: hardening in a nearly round phantom makes R three times as long.
    """
    if not 1.0 / FARTHEST < source_distance_mm / scanner.source_to_cor_mm < FARTHEST:
        raise CalibrationError(
            "phantom-not-seen",
            f"the best geometry puts the source at {source_distance_mm:.4g} mm where source_to_cor_mm is "
            f"{scanner.source_to_cor_mm:.6g}: check that constant, the phantom's size (in mm), and the handedness "
            "and rotation if they were given",
        )
