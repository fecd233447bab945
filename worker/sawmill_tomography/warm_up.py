"""Load or compile the kernels, so that no job and no command waits for it.

`python -m sawmill_tomography.warm_up PART` compiles one part in a process by itself: Numba compiles one kernel
at a time in a process, so several parts are compiled at once by several processes (`sawmill compile`).
"""

import sys
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, FloatArray, Scanner, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.kernel_cache import holds_all
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction import cost
from sawmill_tomography.reconstruction.fbp import fbp

SCANNER = Scanner(source_to_cor_mm=850.0, num_detector_pixels=640, detector_pitch_mm=1.8)
THETA = Theta(0.3, 700.0, 200.0, 20.0, 0.1)


def _scan(views: int) -> tuple[FanBeamGeometry, FloatArray]:
    """Return a geometry and the sinogram (views, cells) of the L in it."""
    geometry = FanBeamGeometry(SCANNER, THETA, np.linspace(0.0, TAU, views + 1)[:-1])
    return geometry, analytic.project(L_SHAPE, DetectorCells.of(SCANNER), geometry.frame, geometry.angles_rad)


def _calibration() -> None:
    geometry, sinogram = _scan(64)
    # The beam's hardening is an effect that is tested view by view.
    hardened = sinogram - 0.3 * sinogram**3 / sinogram.max() ** 2
    calibrate(CalibrationTask(SCANNER, L_SHAPE, hardened, geometry.angles_rad))
    # For wood that is not as it was drawn.
    analytic.project(L_SHAPE, DetectorCells.of(SCANNER), geometry.frame, geometry.angles_rad, derivatives=True)


def _slices() -> None:
    geometry = FanBeamGeometry(SCANNER, THETA, np.linspace(0.0, TAU, 65)[:-1])
    sinogram = np.ones((64, SCANNER.num_detector_pixels))
    projector = Projector(geometry, ImageGrid(16, 400.0))
    fbp(projector, sinogram)
    fbp(projector, np.repeat(sinogram[None], cost.FEW_LANES + 1, axis=0))
    # One view fewer, and no view is a quarter turn from another.
    fbp(Projector(geometry.with_angles(geometry.angles_rad[1:]), projector.grid), sinogram[1:])


def _log_with_metal() -> None:
    # Imported only here, as in the next parts: a command that calibrates does not wait for it. Rods are fitted with
    # `scipy.optimize`, which is otherwise imported at its first use.
    import scipy.optimize  # noqa: F401, PLC0415

    from sawmill_tomography.drift.view_pairs.behind_metal import rays_behind_metal  # noqa: PLC0415

    geometry, sinogram = _scan(20)
    middle = np.abs(np.arange(SCANNER.num_detector_pixels) - SCANNER.num_detector_pixels // 2)
    metal = np.broadcast_to(middle < 5, sinogram.shape)
    rays_behind_metal(SCANNER, sinogram, geometry.angles_rad, geometry.frame, metal)


def _simulated_counts() -> None:
    from sawmill_tomography.projection.simulate import simulate_stack  # noqa: PLC0415

    geometry, _ = _scan(4)
    simulate_stack([L_SHAPE.of_density(0.01)], geometry, seed=0)


def _iterative_methods() -> None:
    # Imported by this part alone: a calibration does not wait for it.
    from sawmill_tomography.reconstruction.cauchy_map import cauchy_map  # noqa: PLC0415
    from sawmill_tomography.reconstruction.tikhonov import tikhonov  # noqa: PLC0415
    from sawmill_tomography.reconstruction.total_variation import ring_tv, total_variation  # noqa: PLC0415

    geometry, sinogram = _scan(20)
    projector = Projector(geometry, ImageGrid(32, 600.0))
    noisy = sinogram + np.random.default_rng(0).normal(scale=0.02 * float(sinogram.std()), size=sinogram.shape)
    for method in (tikhonov, cauchy_map, ring_tv):
        method(projector, noisy)
    for ring_weight in (1.0, 0.5):
        pair = np.stack([noisy, noisy])
        total_variation(projector, pair, weight=1.0, ring_weight=ring_weight, coupling=0.5, iterations=2)
    # One view fewer, and no view is a quarter turn from another: kernels of one lane.
    tikhonov(Projector(geometry.with_angles(geometry.angles_rad[1:]), projector.grid), noisy[1:])
    _log_with_metal()


PARTS: Mapping[str, Callable[[], None]] = MappingProxyType(
    {
        "slices": _slices,
        "calibration": _calibration,
        "iterative methods": _iterative_methods,
        "simulated counts": _simulated_counts,
    }
)


def warm_up() -> None:
    """Load or compile every job's kernels on a small scan: a fraction of a second cached, some ten seconds compiled."""
    _calibration()
    _slices()
    _log_with_metal()


def load_iterative_methods() -> None:
    """Compile the kernels of the fitted methods if no cache has them: a cached kernel is loaded at its first call."""
    # Imported here, as these are not needed by a calibration.
    from sawmill_tomography.projection import _projector_numba  # noqa: PLC0415
    from sawmill_tomography.reconstruction.iterative import _descent_numba, _haar_numba, _prior_numba  # noqa: PLC0415

    if not holds_all(_projector_numba, _descent_numba, _haar_numba, _prior_numba):
        _iterative_methods()


if __name__ == "__main__":
    PARTS[sys.argv[1]]()
