"""The published pipeline, put together from the paper (arXiv 2206.14444) with ODL 1.0 on ASTRA's CPU projector."""

import math
import warnings
from collections.abc import Callable

import numpy as np
import odl
from odl.applications import tomo
from scanners import SCANNER
from scans import ANGLES, TRUE_THETA, published_l_phantom, sources
from scipy.optimize import OptimizeResult, differential_evolution

from sawmill_tomography.calibration.paper import remove_background
from sawmill_tomography.geometry.geometry import TAU, FloatArray, Scanner, Theta, ThetaBounds, bounds_array
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.phantom import Phantom

SIZE, FIELD_MM = 256, 400.0
# The published scan is of a drawing of 1417 x 1417 pixels, on a constant.
DRAWING_SIZE, BACKGROUND = 1417, 3.3477


def fan_beam_geometry(scanner: Scanner, theta: Theta, views: int) -> tomo.FanBeamGeometry:
    """Return ODL's geometry of theta for equidistant views over the full turn, cell-centred like the published data."""
    c, s = math.cos(theta.initial_angle_rad), math.sin(theta.initial_angle_rad)
    turn = np.array([[c, -s], [s, c]])
    half = 0.5 * scanner.num_detector_pixels * scanner.detector_pitch_mm

    def shifted(by_mm: float) -> Callable[[FloatArray], FloatArray]:
        return lambda angle: np.stack([np.zeros_like(angle), np.full_like(angle, by_mm)], -1)

    return tomo.FanBeamGeometry(
        odl.uniform_partition(0.0, TAU, views),
        odl.uniform_partition(-half, half, scanner.num_detector_pixels),
        src_radius=scanner.source_to_cor_mm,
        det_radius=theta.detector_to_cor_mm,
        src_to_det_init=turn @ [0.0, 1.0],
        det_axis_init=turn @ [1.0, theta.detector_tilt] / math.hypot(1.0, theta.detector_tilt),
        src_shift_func=shifted(theta.source_shift_mm),
        det_shift_func=shifted(theta.detector_shift_mm),
    )


def claimed_scan() -> FloatArray:
    """Return the published scan, (360, 768), or a scan of the same kind where its data are absent."""
    return published_l_phantom() if "published" in sources() else pixel_scan(ANGLES.size)


def pixel_scan(views: int) -> FloatArray:
    """Project a pixel image of the L-phantom by ASTRA at the published theta, (views, cells), on the background.

    It stands in for the published scan: steps of pixels, one ray a cell, no noise, nothing of the product's projector.
    """
    half = 0.5 * FIELD_MM
    space = odl.uniform_discr([-half] * 2, [half] * 2, (DRAWING_SIZE, DRAWING_SIZE), dtype="float32")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ODL recommends a graphics card
        transform = tomo.RayTransform(space, fan_beam_geometry(SCANNER, TRUE_THETA, views), impl="astra_cpu")
        drawing = space.element(L_SHAPE.rasterise(DRAWING_SIZE, FIELD_MM).round())
        return np.asarray(transform(drawing).data, np.float64) + BACKGROUND


class PublishedObjective:
    """J(theta) = -max(<X_ref, FBP_theta>, <mirror X_ref, FBP_theta>) with ODL's `fbp_op`."""

    def __init__(self, scanner: Scanner, phantom: Phantom, sinogram: FloatArray) -> None:
        self._scanner = scanner
        self._sinogram = remove_background(sinogram).astype(np.float32)
        self._reference = phantom.rasterise(SIZE, FIELD_MM)
        half = 0.5 * FIELD_MM
        self._space = odl.uniform_discr([-half] * 2, [half] * 2, (SIZE, SIZE), dtype="float32")

    def image(self, theta: Theta) -> FloatArray:
        """Compute the FBP image [x, y] at theta."""
        geometry = fan_beam_geometry(self._scanner, theta, len(self._sinogram))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # ODL recommends a graphics card
            transform = tomo.RayTransform(self._space, geometry, impl="astra_cpu")
            fbp = tomo.fbp_op(transform, padding=True, filter_type="Hann", frequency_scaling=1.0)
            return np.asarray(fbp(transform.range.element(self._sinogram)).data)

    def __call__(self, vector: FloatArray) -> float:
        """Return J at (alpha0, r_D, h_S, h_D, alpha_D)."""
        image = self.image(Theta.from_vector(vector))
        return -max(float(np.vdot(self._reference, image)), float(np.vdot(self._reference[:, ::-1], image)))


def search(objective: PublishedObjective, seed: int) -> OptimizeResult:
    """Run the published search: best/1/bin, crossover 0.7, SciPy's defaults for the rest."""
    return differential_evolution(
        objective,
        bounds_array(ThetaBounds()),
        strategy="best1bin",
        recombination=0.7,
        mutation=(0.5, 1.0),
        rng=np.random.default_rng(seed),
    )
