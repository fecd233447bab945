"""Analytic fan-beam projection of polygons and discs, and its derivatives: no pixels anywhere."""

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import ArrayLike

from sawmill_tomography.geometry.detector_shape import detector_lines
from sawmill_tomography.geometry.geometry import FloatArray, GeometryError, Scanner, SourceFrame, to_vector
from sawmill_tomography.phantoms.phantom import Body, Phantom
from sawmill_tomography.projection import _analytic_numba as kernels
from sawmill_vocabulary import DetectorModule

PARAMETERS = kernels.PARAMETERS
# The phantom's position x, y in mm: one for all views, or (views, 2).
Position = tuple[float, float] | FloatArray
# Below this number of samples one thread ends before further threads have woken up.
WORTH_THREADS = 40_000
# The flat pieces of an arc depart from it by this depth, which moves a ray by a tenth of it or less.
DEEPEST_MM = 0.01


@dataclass(frozen=True)
class DetectorCells:
    """Positions of the detector's cells."""

    first_border_mm: float  # border of the first cell, and the width of a cell
    width_mm: float
    count: int
    modules: tuple[DetectorModule, ...] = ()  # modules after the first
    arc_radius_mm: float | None = None
    waves_mm: tuple[float, ...] = ()  # how far cells lie from equal distances (`detector_shape.waves`)

    @classmethod
    def of(cls, scanner: Scanner, *, binned: int = 1) -> "DetectorCells":
        """Return the scanner's cells, combined in groups of `binned`; a remainder at the far end is left out.

        Gaps and kinks between modules are too small for combined cells, which do not have them.
        """
        return cls(
            -0.5 * scanner.num_detector_pixels * scanner.detector_pitch_mm,
            scanner.detector_pitch_mm * binned,
            scanner.num_detector_pixels // binned,
            scanner.detector_modules if binned == 1 else (),
            scanner.detector_arc_radius_mm,
            scanner.detector_waves_mm,
        )

    def divided(self, parts: int) -> "DetectorCells":
        """Return the cells divided into this number of equal parts."""
        modules = tuple(replace(module, first_cell=parts * module.first_cell) for module in self.modules)
        return replace(self, width_mm=self.width_mm / parts, count=self.count * parts, modules=modules)

    def lines(self, frame: SourceFrame) -> FloatArray:
        """Return a row (15,) for each flat piece.

        First cell, end, source frame (5,), slopes of SDD (3,) and of u_c (3,), tangents of the angles from the COR to
        both ends.
        """
        arc = self.arc_radius_mm
        if arc is None and not self.modules and not self.waves_mm:
            # The line of the frame, whose SDD and u_c are their own slopes.
            return self._with_tangents([[0.0, self.count, *to_vector(frame), 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]])
        lines = detector_lines(
            self.modules,
            arc,
            self.count,
            self.first_border_mm,
            self.width_mm,
            frame,
            piece_cells=1 if arc is None else max(1, int(math.sqrt(8.0 * DEEPEST_MM * arc) / self.width_mm)),
            waves_mm=self.waves_mm,
        )
        of_all = np.broadcast_to([frame.psi_rad, frame.source_distance_mm], (len(lines.first), 2))
        return self._with_tangents(np.column_stack([lines.first, lines.end, of_all, *lines[2:]]))

    def _with_tangents(self, rows: ArrayLike) -> FloatArray:
        lines = np.asarray(rows)
        sdd, column, tilt = lines[:, 4:7].T[..., None]
        along = self.first_border_mm + self.width_mm * lines[:, :2] - column
        # An end behind the source counts as one at its side.
        ahead = np.maximum(sdd + along * np.sin(tilt), 1e-9 * sdd)
        return np.concatenate([lines, along * np.cos(tilt) / ahead], axis=1)


def clears(phantom_radius_mm: float, frame: SourceFrame) -> bool:
    """Return whether a phantom of this radius around the COR is in front of the source, along the detector normal."""
    return frame.source_distance_mm * math.cos(frame.tilt_rad) > 1.02 * phantom_radius_mm


def _check(phantom: Phantom | Body, frame: SourceFrame, position_mm: Position) -> None:
    reach = phantom.radius_mm + float(np.hypot(*np.transpose(position_mm)).max(initial=0.0))
    if not clears(reach, frame):
        raise GeometryError(
            f"the phantom {phantom.name!r} reaches {reach:.4g} mm from the centre of rotation, so far that it touches "
            f"the source at {frame.source_distance_mm:.4g} mm (tilt {frame.tilt_rad:.3g} rad)"
        )


def project(
    phantom: Phantom | Body,
    cells: DetectorCells,
    frame: SourceFrame,
    angles_rad: FloatArray,
    *,
    position_mm: Position = (0.0, 0.0),
    rays_per_cell: int | None = None,
    derivatives: bool = False,
) -> FloatArray:
    """Compute the phantom's sinogram, or that and its derivatives by the geometry and by deformations of the wood.

    Parameters
    ----------
    phantom : Phantom
        The phantom, to be moved by `position_mm` in the image frame: (x, y), or (views, 2) for one in each view.
    cells : DetectorCells
        Positions of the cells.
    frame : SourceFrame
        The geometry.
    angles_rad : (views,) float64
        View angles in the scanner's sense of rotation.
    rays_per_cell : int, optional
        Number of equidistant rays for each cell; by default the mean over the whole cell.
    derivatives : bool
        Whether the derivatives are computed.

    Returns
    -------
    (views, cells) or (12, views, cells) float64
        Line integrals, mm times density. With derivatives: those by (psi, R, SDD, u_c, tau, t_x, t_y); the line
        integrals; the first moments (integrals of x and of y along the ray); the derivatives by aspect (x longer and y
        shorter by half of it, in the drawing's axes, about its origin) and by shear.

    Raises
    ------
    GeometryError
        If the phantom reaches the source.
    """
    _check(phantom, frame, position_mm)
    out = np.empty((*(kernels.ROWS,) * derivatives, angles_rad.size, cells.count))
    kernel = kernels.project_in_one_thread if out.size < WORTH_THREADS else kernels.project
    kernel = kernels.project_with_deformations if derivatives else kernel
    kernel(*kernel_arguments(phantom, cells, frame, angles_rad, position_mm, rays_per_cell), out)
    return out


def blur_taps(width_cells: float) -> FloatArray:
    """Return the discrete Gaussian of this standard deviation, middle first: exp(-t) I_j(t), t its square.

    Unlike a sampled Gaussian it has the given variance, however narrow, and its cosine transform is exp(t (cos w - 1))
    (Lindeberg 1990).
    """
    taps = np.asarray(scipy.special.ive(np.arange(math.ceil(4.5 * width_cells) + 2), width_cells**2), np.float64)
    return np.asarray(taps / (2.0 * taps.sum() - taps[0]))


def gram(
    phantom: Phantom,
    cells: DetectorCells,
    frame: SourceFrame,
    angles_rad: FloatArray,
    sinogram: FloatArray,
    *,
    position_mm: Position = (0.0, 0.0),
    rays_per_cell: int | None = None,
    weights: FloatArray | None = None,
) -> FloatArray:
    """Compute each view's inner products over the cells of (7 derivatives, projection, 1, sinogram): (views, 10, 10).

    Least squares needs nothing else, so the derivative is never stored. `weights` (views, cells) multiply each
    cell's products; None gives equal weights.
    """
    _check(phantom, frame, position_mm)
    out = np.empty((angles_rad.size, kernels.TERMS, kernels.TERMS))
    arguments = kernel_arguments(phantom, cells, frame, angles_rad, position_mm, rays_per_cell)
    kernel = kernels.gram_in_one_thread if sinogram.size < WORTH_THREADS else kernels.gram
    kernel(*arguments, sinogram, np.empty((0, 0)) if weights is None else weights, out)
    return out


def kernel_arguments(
    phantom: Phantom | Body,
    cells: DetectorCells,
    frame: SourceFrame,
    angles_rad: FloatArray,
    position_mm: Position,
    rays_per_cell: int | None,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, float, float, int]:
    """Return the first arguments of every kernel."""
    positions = np.empty((2, angles_rad.size))
    positions.T[:] = position_mm
    return (
        phantom.edges,
        phantom.discs,
        cells.lines(frame),
        *positions,
        np.ascontiguousarray(angles_rad, np.float64),
        cells.first_border_mm,
        cells.width_mm,
        rays_per_cell or 0,
    )
