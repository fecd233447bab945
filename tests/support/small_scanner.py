"""A small scanner and a calibration of it, which the tests of jobs and of use cases share."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import results

from sawmill_calibration.known_geometry import GivenGeometry
from sawmill_calibration.scans.scan_rows import ScanRows
from sawmill_contracts.calibrations import CalibrationOptions, CalibrationSucceeded
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.scanners import ScannerSpec, Tolerances
from sawmill_tomography.geometry.geometry import FanBeamGeometry, FloatArray, Scanner
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.projection.analytic import DetectorCells, project
from sawmill_vocabulary import Theta

SCANNER = Scanner(source_to_cor_mm=859.46, num_detector_pixels=128, detector_pitch_mm=9.0)
CONSTANTS = ScannerConstants(**vars(SCANNER))
THETA = Theta(0.9, 710.0, 240.0, 35.0, 0.2)


@pytest.fixture
def scanner() -> Scanner:
    return SCANNER


@pytest.fixture
def constants() -> ScannerConstants:
    return CONSTANTS


@pytest.fixture
def theta() -> Theta:
    return THETA


@pytest.fixture
def sinogram() -> Callable[[FloatArray], FloatArray]:
    """Of the L at the fixture's theta, at any angles."""

    def of(angles: FloatArray) -> FloatArray:
        fan = FanBeamGeometry(SCANNER, THETA, angles)
        return project(L_SHAPE, DetectorCells.of(SCANNER), fan.frame, angles, rays_per_cell=8)

    return of


@pytest.fixture
def calibration() -> Callable[..., CalibrationSucceeded]:
    """A calibration that found a theta."""

    def found(theta: Theta = THETA, **changes: Any) -> CalibrationSucceeded:
        ids = {"scanner_id": "line-2", "scan_id": "scan", "phantom_id": "l-shape", "job_id": "job", "id": "found"}
        unknown = dict.fromkeys(("standard_deviation", "covariance", "predicted_ray_error_mm")) | {"views": 60}
        made = {"created_at": "2030-01-01T00:00:00Z", "options": CalibrationOptions(), "scanner": CONSTANTS}
        frame = theta.source_frame(SCANNER.source_to_cor_mm)
        known = results.calibration_result(**ids, **unknown, **made, theta=theta, source_frame=frame)
        return CalibrationSucceeded.model_validate(known | changes)

    return found


@pytest.fixture
def turn() -> Callable[[int], FloatArray]:
    """View k of n at (k + 1/2) / n of a turn."""
    return lambda views: (np.arange(views) + 0.5) * 2.0 * np.pi / views


@pytest.fixture
def spec() -> Callable[..., ScannerSpec]:
    """The scanner with tolerances of the test's own."""
    return lambda **tolerances: ScannerSpec(name="Line 2", constants=CONSTANTS, tolerances=Tolerances(**tolerances))


@dataclass(frozen=True, eq=False)
class LogRows(ScanRows):
    """Rows of a log, with the theta of their reconstruction."""

    theta: Theta | None = None

    @property
    def geometry(self):
        return GivenGeometry(self.scanner, self.theta)


def reconstruction_input(stack, fan, *, first_row=0, counts=False):
    """Of a stack (views, rows, detector) in this geometry."""
    rows = (first_row, first_row + stack.shape[1])
    return LogRows(
        lambda start, stop: stack[:, start:stop],
        lambda row: stack[:, row - first_row],
        usable_rows=rows,
        angles_rad=fan.angles_rad,
        rows=rows,
        row_step=1,
        scanner=ScannerConstants(**vars(fan.scanner)),
        counts=counts,
        sha256="0" * 64,
        remarks=(),
        theta=fan.theta,
    )
