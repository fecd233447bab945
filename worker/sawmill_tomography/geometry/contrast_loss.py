"""The loss of contrast and of sharpness that a geometry error causes (docs/look-up/conventions.md#loss-of-contrast)."""

import numpy as np

from sawmill_tomography.geometry.geometry import TAU, FloatArray, Scanner, SourceFrame
from sawmill_tomography.geometry.ray_error import predicted_ray_error, ring_displacements
from sawmill_vocabulary.uncertainty import ContrastLoss

# Diameter of the knot. Its contrast is the mean within its radius less the mean in the ring around it, from the first
# to the second of these numbers, in its radius. The frequency of the MTF, cycles per mm: a period is a knot's diameter.
KNOT_MM, AROUND, MTF_PER_MM = 10.0, (1.3, 2.0), 0.1
# Errors that are drawn from a covariance. Frequencies and displacements of the table of a knot's loss.
DRAWS, FREQUENCIES, DISPLACEMENTS = 256, 400, 400


def contrast_loss(scanner: Scanner, frame: SourceFrame, error: FloatArray, *, radius_mm: float) -> ContrastLoss:
    """Predict the losses in an image whose geometry is wrong by `error`.

    Over a full turn, filtered back-projection makes the spectrum at a frequency from the two opposite rays across it. A
    displacement d of a ray multiplies its part by exp(-2 pi i f d), so that the mean over the directions at a place is
    the mean of cos(2 pi f d) over its rays.

    Parameters
    ----------
    error : (n,) float64
        Errors of (psi, R, SDD, u_c, tau), rad and mm, and of what follows in the covariance of `predicted_ray_error`.
    radius_mm : float
        Radius of the log's disc.
    """
    return ContrastLoss(*_losses(scanner, frame, error[None], radius_mm)[0].tolist())


def contrast_loss_bound(
    scanner: Scanner, frame: SourceFrame, covariance: FloatArray, upper_95_mm: float, *, radius_mm: float
) -> ContrastLoss:
    """Predict the losses that are not exceeded in 95 of 100 cases.

    The errors have the proportions of `covariance` (as of `predicted_ray_error`), and a size by which the ray error
    stays below `upper_95_mm` in 95 of 100 cases.
    """
    own_mm = predicted_ray_error(scanner, frame, covariance, radius_mm=radius_mm).upper_95_mm
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0)) * (upper_95_mm / own_mm if own_mm else 0.0)
    errors = np.random.default_rng(0).standard_normal((DRAWS, len(covariance))) @ root.T
    return ContrastLoss(*np.quantile(_losses(scanner, frame, errors, radius_mm), 0.95, axis=0).tolist())


def _losses(scanner: Scanner, frame: SourceFrame, errors: FloatArray, radius_mm: float) -> FloatArray:
    """Return the losses of a knot's contrast and of the MTF by errors (n, parameters), (n, 2), per cent."""
    by_parameter, weights = ring_displacements(scanner, frame, errors.shape[1], radius_mm=radius_mm)
    displacements = np.abs(by_parameter.reshape(-1, errors.shape[1]) @ errors.T)
    of_knots = np.interp(displacements, *_knot_losses(scanner.detector_pitch_mm / frame.magnification))
    of_mtf = 1.0 - np.cos(TAU * MTF_PER_MM * displacements)
    return np.clip(100.0 * np.stack([weights.ravel() @ of_knots, weights.ravel() @ of_mtf], -1), 0.0, 100.0)


def _knot_losses(cell_mm: float) -> tuple[FloatArray, FloatArray]:
    """Return displacements, mm, and the losses of a knot's contrast by rays that are all displaced as far."""
    f: FloatArray = np.asarray((np.arange(FREQUENCIES) + 0.5) * 0.5 / (FREQUENCIES * cell_mm))
    radius, (near, far) = 0.5 * KNOT_MM, AROUND
    # Transforms of discs over pi f: of the knot, and of the ring around it (Bracewell 2000, chapter 13).
    disc, inner, outer = (reach * _bessel_j1(TAU * reach, f) / f for reach in (radius, near * radius, far * radius))
    measured = disc / radius**2 - (outer - inner) / ((far**2 - near**2) * radius**2)
    # The image without an error: Hann's window, the mean over the cell's width, linear interpolation between cells, and
    # the mean over a pixel as wide as a cell at the COR (docs/look-up/conventions.md#filtered-back-projection).
    transfer = (0.5 + 0.5 * np.cos(TAU * f * cell_mm)) * np.sinc(f * cell_mm) ** 4
    kernel = disc * measured * transfer * f
    displacements = np.linspace(0.0, 3.0 * KNOT_MM, DISPLACEMENTS)
    return displacements, 1.0 - np.cos(TAU * np.outer(displacements, f)) @ kernel / kernel.sum()


def _bessel_j1(times: float, x: FloatArray) -> FloatArray:
    """Return J1 of `times` x by the midpoint rule (DLMF 10.9.2): importing `scipy.special` delays each start."""
    angles = 0.5 * TAU * (np.arange(nodes := int(times * x.max()) + 32) + 0.5) / nodes
    return np.asarray(np.cos(angles - times * np.outer(x, np.sin(angles))).mean(axis=1))
