"""The poses of a log's views where the log is turned between passages: a shift and a roll of its own for each view.

The phantom's poses do not transfer to a log, so they are found from the log itself: image and poses in turn. Each view
is compared with an image made without it, which therefore has not adapted to that view's wrong pose. The mean shift and
the mean roll move the whole image, and are removed.
"""

import math
from dataclasses import dataclass

import numpy as np

from sawmill_tomography.geometry.geometry import FanViews, FloatArray, GeometryError
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.reconstruction.iterative.progress import OnProgress
from sawmill_tomography.reconstruction.object_extent import object_radius_mm
from sawmill_tomography.reconstruction.total_variation import total_variation
from sawmill_tomography.reconstruction.total_variation_weights import choose_weight
from sawmill_tomography.sinograms.noise import noise_of_each_ray

# Pixels across the log, and its diameter with a margin for views that stand elsewhere.
SIZE, MARGIN = 128, 1.04
# Groups of views, each left out of an image of the others; and the least number of views that an image is made of.
FOLDS, LEAST_VIEWS = 5, 8
# Rounds of image and poses end when shifts across the beam change by less; shifts to 2 mm take some five rounds.
ROUNDS, SETTLED_MM = 16, 0.02
# Share of a Gauss-Newton step: views on either side of the log correct the same error, and whole steps overshoot.
STEP = 0.7
# Standard deviation of the shift in mm and of the roll in rad that the first round expects; later ones take the scan's.
# Concentric rings hardly tell a roll, so its size never exceeds the first one.
EXPECTED_SHIFT_MM, EXPECTED_ROLL_RAD = 1.5, math.radians(0.3)
# The least standard deviation, as a share of the expected one: a size of zero would never grow again.
LEAST_SHARE = 0.01
# Cells that are summed to see residuals that neighbouring cells share.
SUMMED_CELLS = 16


@dataclass(frozen=True, eq=False)
class ViewPoses:
    """Where the log stands in each view, relative to its mean place: turned about the COR, then shifted."""

    across_mm: FloatArray  # (views,): shift along the detector's axis
    along_mm: FloatArray  # (views,): shift from the source to the detector's line, across its axis
    roll_rad: FloatArray  # (views,): counter-clockwise

    def of(self, geometry: FanViews) -> FanViews:
        """Return the views of a geometry as a log sees them that stands still."""
        shift = np.einsum("vij,vi->vj", _beam_axes(geometry), np.stack([self.across_mm, self.along_mm], -1))
        return geometry.moved(shift, self.roll_rad)


def find_view_poses(geometry: FanViews, lines: Image, on_progress: OnProgress = lambda _: None) -> ViewPoses:
    """Find the pose of each view from some rows of a log (docs/understand/reconstruction.md#poses).

    Parameters
    ----------
    geometry : FanViews
        Views of a log that is turned about one axis.
    lines : (rows, views, detector) float32
        Line integrals whose air is at 0; the log has the same pose in all rows.

    Raises
    ------
    GeometryError
        The shapes do not fit, a row is 0 in every ray, or there are fewer than `LEAST_VIEWS` views.
    """
    views = geometry.angles_rad.size
    if views < LEAST_VIEWS:
        raise GeometryError(f"the poses of {views} views cannot be found: at least {LEAST_VIEWS} are needed")
    radius_mm = max(object_radius_mm(geometry, line) for line in lines)
    grid = ImageGrid(SIZE, 2.0 * MARGIN * radius_mm)
    while len(geometry.borders_mm) % 2 == 0 and 2.0 * geometry.cell_at_cor_mm <= grid.pixel_mm:
        geometry, lines = geometry.in_pairs(), 0.5 * (lines[..., ::2] + lines[..., 1::2])
    search = _Search(geometry, grid, lines)
    poses, sizes = np.zeros((views, 3)), np.array([EXPECTED_SHIFT_MM, EXPECTED_SHIFT_MM, EXPECTED_ROLL_RAD])
    for done in range(ROUNDS):
        before = poses
        poses, sizes = search.corrected(poses, sizes)
        on_progress((done + 1) / ROUNDS)
        if np.sqrt(np.mean((poses - before)[:, 0] ** 2)) < SETTLED_MM:
            break
    return ViewPoses(*poses.T)


class _Search:
    """The rows of a log, and the images and corrections of each round."""

    def __init__(self, geometry: FanViews, grid: ImageGrid, lines: Image) -> None:
        self._geometry, self._grid, self._lines = geometry, grid, lines
        self._fold = np.arange(lines.shape[1]) % FOLDS
        self._axes = _beam_axes(geometry)
        self._weight = choose_weight(Projector(geometry, grid), lines[len(lines) // 2]).weight
        # Each row once for each fold, with the fold's views left out.
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
        expected = np.array([EXPECTED_SHIFT_MM, EXPECTED_SHIFT_MM, EXPECTED_ROLL_RAD])
        shift = np.einsum("vij,vi->vj", self._axes, poses[:, :2])
        poses[:, :2] -= np.einsum("vij,j->vi", self._axes, shift.mean(axis=0))
        poses[:, 2] -= poses[:, 2].mean()
        return poses, np.clip(grown, LEAST_SHARE * expected, [np.inf, np.inf, EXPECTED_ROLL_RAD])

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
