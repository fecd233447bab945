"""Poses of the views of a log that is turned between passages: a shift and a roll in each view.

A phantom's poses do not transfer to a log, so they are found from the log: image and poses in turn. Each view is
compared with an image that was made without it, and has not adapted to a wrong pose of that view. The mean shift and
the mean roll move the whole image, and are removed.
"""

import math
from dataclasses import dataclass

import numpy as np

from sawmill_tomography.geometry.geometry import FanViews, FloatArray, GeometryError
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.reconstruction.object_extent import object_radius_mm
from sawmill_tomography.reconstruction.total_variation import total_variation
from sawmill_tomography.reconstruction.total_variation_weights import choose_weight
from sawmill_tomography.sinograms.air import find_air
from sawmill_tomography.sinograms.noise import noise_of_each_ray

# Pixels across the log, and the field as a multiple of the diameter, so that shifted views fit.
SIZE, MARGIN = 128, 1.04
# Number of groups of views, one of which is left out of an image; the least number of views.
FOLDS, LEAST_VIEWS = 5, 8
# Rounds of image and poses end when shifts across the beam change by less; shifts to 2 mm take some five rounds.
ROUNDS, SETTLED_MM = 16, 0.02
# Share of a Gauss-Newton step: views on either side of the log correct the same error, so whole steps overshoot.
STEP = 0.7
# Standard deviations of shifts across and along the beam, mm, and of rolls, rad, which the first round expects, and
# their bounds in later rounds. Concentric rings hardly tell a roll; a size of zero would never grow again.
EXPECTED = np.array([1.5, 1.5, math.radians(0.3)])
BOUNDS = 0.01 * EXPECTED, np.array([np.inf, np.inf, EXPECTED[2]])
# Cells that are summed to see residuals that neighbouring cells share.
SUMMED_CELLS = 16


@dataclass(frozen=True, eq=False)
class ViewPoses:
    """Pose of a log in each view, relative to the mean pose: turned about the COR, then shifted."""

    across_mm: FloatArray  # (views,): shift along the detector's axis
    along_mm: FloatArray  # (views,): shift from the source to the detector's line, across its axis
    roll_rad: FloatArray  # (views,): counter-clockwise

    def of(self, geometry: FanViews) -> FanViews:
        """Return the views of a geometry in the frame of the log."""
        shift = np.einsum("vij,vi->vj", _beam_axes(geometry), np.stack([self.across_mm, self.along_mm], -1))
        return geometry.moved(shift, self.roll_rad)


def is_between_air(line: Image) -> bool:
    """Return whether a row (views, detector) shows wood with air on both sides: a cut outline tells no shift."""
    air = find_air(line)
    return air is not None and bool(air.cells[0] and air.cells[-1] and not air.cells.all())


def find_view_poses(geometry: FanViews, lines: Image) -> ViewPoses:
    """Find the pose of each view from some rows of a log (docs/understand/reconstruction.md#poses).

    Parameters
    ----------
    geometry : FanViews
        Views of a log that is turned about one axis.
    lines : (rows, views, detector) float32
        Line integrals whose air is at 0, each `is_between_air`; the log has the same pose in all rows.

    Raises
    ------
    GeometryError
        The shapes do not fit, a row is 0 in every ray, or there are fewer than `LEAST_VIEWS` views.
    """
    views = geometry.angles_rad.size
    if views < LEAST_VIEWS:
        raise GeometryError(f"the poses of {views} views cannot be found: at least {LEAST_VIEWS} are needed")
    grid = ImageGrid(SIZE, 2.0 * MARGIN * max(object_radius_mm(geometry, line) for line in lines))
    while len(geometry.borders_mm) % 2 == 0 and 2.0 * geometry.cell_at_cor_mm <= grid.pixel_mm:
        geometry, lines = geometry.in_pairs(), 0.5 * (lines[..., ::2] + lines[..., 1::2])
    search = _Search(geometry, grid, lines)
    poses, sizes, before = np.zeros((views, 3)), EXPECTED, np.full((views, 3), np.inf)
    for _ in range(ROUNDS):
        if np.sqrt(np.mean((poses - before)[:, 0] ** 2)) < SETTLED_MM:
            break
        before, (poses, sizes) = poses, search.corrected(poses, sizes)
    return ViewPoses(*poses.T)


class _Search:
    """Search for the poses of the views in rows of a log."""

    def __init__(self, geometry: FanViews, grid: ImageGrid, lines: Image) -> None:
        self._geometry, self._grid, self._lines = geometry, grid, lines
        self._fold = np.arange(lines.shape[1]) % FOLDS
        self._axes = _beam_axes(geometry)
        self._weight = choose_weight(Projector(geometry, grid), lines[len(lines) // 2]).weight
        # Copies of the rows for each fold, without the views of the fold.
        noise = np.broadcast_to(noise_of_each_ray(None, lines), lines.shape)
        left_out = self._fold == np.arange(FOLDS)[:, None]
        self._noise = np.where(left_out[:, None, :, None], np.inf, noise).reshape(-1, *lines.shape[1:])

    def corrected(self, poses: FloatArray, sizes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return poses (views, 3) after a Gauss-Newton step to the images without each view, and their sizes (3,)."""
        residual, slopes = self._compared(ViewPoses(*poses.T).of(self._geometry))
        cells = residual.shape[-1] // SUMMED_CELLS * SUMMED_CELLS
        sums = residual[..., :cells].reshape(*residual.shape[:-1], -1, SUMMED_CELLS).sum(axis=-1)
        variance = max(float(np.mean(residual**2)), float(np.mean(sums**2)) / SUMMED_CELLS)
        prior = np.diag(1.0 / sizes**2)
        spread = np.linalg.inv(np.einsum("arvc,brvc->vab", slopes, slopes, dtype=np.float64) / variance + prior)
        pull = np.einsum("arvc,rvc->va", slopes, residual, dtype=np.float64) / variance - poses @ prior
        poses = poses + STEP * np.einsum("vab,vb->va", spread, pull)
        # Sizes by expectation maximisation: independent poses of unknown variance.
        grown = np.sqrt(np.mean(poses**2 + np.diagonal(spread, axis1=1, axis2=2), axis=0))
        shift = np.einsum("vij,vi->vj", self._axes, poses[:, :2])
        poses[:, :2] -= np.einsum("vij,j->vi", self._axes, shift.mean(axis=0))
        poses[:, 2] -= poses[:, 2].mean()
        return poses, np.clip(grown, *BOUNDS)

    def _compared(self, posed: FanViews) -> tuple[FloatArray, FloatArray]:
        """Return data less prediction (rows, views, cells), and the prediction's slopes by the pose (3, ...)."""
        rows, grid = len(self._lines), self._grid
        copies = np.tile(self._lines, (FOLDS, 1, 1))
        made = total_variation(Projector(posed, grid), copies, weight=self._weight, noise=self._noise).image
        residual, slopes = np.empty(self._lines.shape), np.empty((3, *self._lines.shape))
        x, y = grid.x_mm[:, None], grid.y_mm
        for fold, images in enumerate(made.reshape(FOLDS, rows, grid.size, grid.size)):
            views = self._fold == fold
            to_x, to_y = (-each for each in np.gradient(images, grid.pixel_mm, axis=(1, 2)))
            moved = np.concatenate([images, to_x, to_y, x * to_y - y * to_x])
            predicted = Projector(posed.at(views), grid).forward(moved).reshape(4, rows, views.sum(), -1)
            residual[:, views] = self._lines[:, views] - predicted[0]
            shifted = np.einsum("vij,jrvc->irvc", self._axes[views], predicted[1:3])
            slopes[:, :, views] = np.concatenate([shifted, predicted[3:]])
        return residual, slopes


def _beam_axes(geometry: FanViews) -> FloatArray:
    """Return the unit vectors along the detector's line and along the beam, (views, 2, 2)."""
    across = geometry.axis
    normal = np.stack([-across[:, 1], across[:, 0]], -1) * np.sign(geometry.depths_mm[0])[:, None]
    return np.stack([across, normal], axis=1)
