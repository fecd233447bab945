"""Load or compile the kernels that every job needs, so that no job pays for it."""

import numpy as np

from sawmill_worker.tomography import analytic
from sawmill_worker.tomography.analytic import DetectorCells
from sawmill_worker.tomography.built_in import L_SHAPE
from sawmill_worker.tomography.calibration.calibrate import calibrate
from sawmill_worker.tomography.calibration.task import CalibrationTask
from sawmill_worker.tomography.fbp import fbp, fbp_block
from sawmill_worker.tomography.geometry import TAU, FanBeamGeometry, Scanner, Theta
from sawmill_worker.tomography.image_grid import ImageGrid
from sawmill_worker.tomography.projector import Projector


def warm_up() -> None:
    """Do the main job once on a small scan: a fraction of a second cached, some thirty seconds compiled."""
    scanner = Scanner(source_to_cor_mm=850.0, num_detector_pixels=640, detector_pitch_mm=1.8)
    angles = np.linspace(0.0, TAU, 65)[:-1]
    geometry = FanBeamGeometry(scanner, Theta(0.3, 700.0, 200.0, 20.0, 0.1), angles)
    sinogram = analytic.project(L_SHAPE, DetectorCells.of(scanner), geometry.frame, angles)
    calibrate(CalibrationTask(scanner, L_SHAPE, sinogram, angles))
    projector = Projector(geometry, ImageGrid(16, 400.0))
    fbp(projector, sinogram)
    fbp_block(projector, sinogram[:, None])
    # A view less, and none is a quarter turn from another.
    fbp(Projector(geometry.with_angles(angles[1:]), projector.grid), sinogram[1:])
