"""Load or compile the kernels that every job needs, so that no job pays for it."""

import numpy as np

from worker.tomography import analytic
from worker.tomography.analytic import DetectorCells
from worker.tomography.built_in import L_SHAPE
from worker.tomography.calibration.search import CoarseMisfit
from worker.tomography.fbp import fbp
from worker.tomography.geometry import FanBeamGeometry, Handedness, Rotation, Scanner, Theta
from worker.tomography.image_grid import ImageGrid
from worker.tomography.projector import Projector


def warm_up() -> None:
    """Run each kernel once on next to nothing: a fraction of a second cached, some twenty seconds compiled."""
    scanner = Scanner(source_to_cor_mm=800.0, num_detector_pixels=16, detector_pitch_mm=60.0)
    angles = np.arange(4) * np.pi / 2.0
    geometry = FanBeamGeometry(scanner, Theta(0.0, 700.0, 0.0, 0.0, 0.0), angles)
    cells, frame = DetectorCells.of(scanner), geometry.frame
    sinogram = analytic.project(L_SHAPE, cells, frame, angles)
    analytic.gram(L_SHAPE, cells, frame, angles, sinogram)
    misfit = CoarseMisfit({Handedness.AS_DRAWN: L_SHAPE}, (Rotation.AS_GIVEN,), sinogram, angles, cells)
    misfit(np.array([800.0, 0.6, 0.0, 0.0]))
    fbp(Projector(geometry, ImageGrid(16, 400.0)), sinogram)
