"""The geometry that a scan is used with: a calibration's, or one given by numbers."""

import math
from dataclasses import dataclass

import numpy as np

from sawmill_calibration.failures import refused
from sawmill_contracts.calibrations import CalibrationResult
from sawmill_contracts.geometry import ScannerConstants
from sawmill_tomography.geometry.geometry import FanBeamGeometry, SourceFrame, Theta
from sawmill_tomography.reconstruction.object_extent import seen_radius_mm
from sawmill_vocabulary import LARGEST_ASSUMED_LOG_RADIUS_MM, Handedness, Rotation
from sawmill_vocabulary.scattered_radiation import NOTHING_FOUND, BeamCorrection

CONSTANTS = ("source_to_cor_mm", "num_detector_pixels", "detector_pitch_mm")


@dataclass(frozen=True)
class GivenGeometry:
    """A geometry given by numbers, without error bars; for a drift check of nominal distances."""

    scanner: ScannerConstants
    theta: Theta
    rotation: Rotation = Rotation.AS_GIVEN
    handedness: Handedness = Handedness.AS_DRAWN

    @property
    def source_frame(self) -> SourceFrame:
        """Source frame of theta."""
        return self.theta.source_frame(self.scanner.source_to_cor_mm)

    @property
    def covariance(self) -> None:
        """Covariance, which a given geometry does not have."""
        return

    @property
    def beam(self) -> BeamCorrection:
        """Corrections of line integrals, which a given geometry does not have."""
        return NOTHING_FOUND

    @property
    def radius_mm(self) -> float:
        """Radius of the disc in which rays are compared: what the detector sees, at most the largest assumed log."""
        seen = seen_radius_mm(FanBeamGeometry(self.scanner, self.theta, np.zeros(1)))
        return min(LARGEST_ASSUMED_LOG_RADIUS_MM, seen)


KnownGeometry = CalibrationResult | GivenGeometry


def check_same_scanner(
    calibrated: ScannerConstants, of_scan: ScannerConstants, names: tuple[str, ...] = CONSTANTS
) -> None:
    """Refuse a calibration whose scanner has other constants of these names than the scan's."""
    for name in names:
        before, now = getattr(calibrated, name), getattr(of_scan, name)
        if not math.isclose(now, before, rel_tol=1e-6):
            raise refused(
                "contradiction",
                f"the calibration is of a scanner with {name} {before:.9g} and the scan has {now:.9g}: "
                "use the calibration of the same scanner",
            )
