"""The scans of benchmarks/log_table.py: the published log and whole logs, and what is measured on their images."""

import math
from dataclasses import dataclass

import numpy as np
from scanners import SCANNER
from scans import ANGLES, GRID, LOG_NOISE, TRUE_THETA, log_sinogram, log_truth
from scipy.ndimage import binary_dilation
from whole_logs import TABLE_SEED, Rows, WholeLog

from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.quality import relative_error

PUBLISHED = "published"
# Every method's error is computed over these rows: some rivals take seconds for each.
JUDGED_STEP = 16
# The ring around an inclusion whose mean the contrast uses: nearest and farthest distance, pixels.
NEAR, FAR = 2, 4


@dataclass(frozen=True, eq=False)
class LogScan:
    """A scan with the truth in hand.

    Attributes
    ----------
    lines : (rows, views, detector) float32
        Line integrals.
    truth : (rows, size, size) float32
        Area mean of each pixel, 1/mm.
    log : WholeLog, optional
        The whole log; None for the published log, which is one row.
    """

    name: str
    projector: Projector
    lines: Rows
    truth: Rows
    log: WholeLog | None

    @property
    def judged(self) -> list[int]:
        """The rows by which all methods are compared."""
        return list(range(min(len(self.truth) // 2, JUDGED_STEP // 2), len(self.truth), JUDGED_STEP))

    def errors(self, images: Rows, rows: list[int]) -> list[float]:
        """Compute the relative error of each of these rows' images, over all pixels."""
        return [relative_error(image, self.truth[row]) for image, row in zip(images, rows, strict=True)]

    def error(self, images: Rows, rows: list[int]) -> float:
        """Compute the mean of the rows' relative errors."""
        return float(np.mean(self.errors(images, rows)))

    def contrast(self, images: Rows, name: str) -> float | None:
        """Compute the contrast of the nail, or the knot, over all its rows, as a share of the truth's; None if absent.

        In a row: the mean over the inclusion's pixels less the mean of the ring around them, NEAR to FAR pixels away.
        """
        if self.log is None:
            return None
        shares = self.log.inclusion_alone(name, self.projector.grid)
        found, true = 0.0, 0.0
        for image, truth, share in zip(images, self.truth, shares, strict=True):
            core = share > 0.5
            if not core.any():
                continue
            ring = binary_dilation(core, iterations=FAR) & ~binary_dilation(core, iterations=NEAR)
            found += float(image[core].mean() - image[ring].mean())
            true += float(truth[core].mean() - truth[ring].mean())
        return found / true if true else None


def published_scan(views: int, noise: float) -> LogScan:
    """Return the published log, which has 2 % noise itself: more is added, less cannot be.

    Raises
    ------
    ValueError
        The noise is less than the data's own, or the number of views does not divide 360.
    """
    if noise < LOG_NOISE:
        raise ValueError(f"the published log has {LOG_NOISE:g} noise: {noise:g} cannot be had")
    if 360 % views:
        raise ValueError(f"the published log has 360 views: {views} are no equal steps of them")
    step = 360 // views
    lines = log_sinogram("published")[::step]
    more = math.sqrt(noise**2 - LOG_NOISE**2) * math.sqrt(float(np.mean(lines**2)))
    lines = lines + more * np.random.default_rng(TABLE_SEED).standard_normal(lines.shape)
    geometry = FanBeamGeometry(SCANNER, TRUE_THETA, ANGLES[::step])
    truth = log_truth("published").astype(np.float32)
    return LogScan(PUBLISHED, Projector(geometry, GRID), lines[None].astype(np.float32), truth[None], None)


def whole_scan(log: WholeLog, truth: Rows, views: int, noise: float, grid: ImageGrid) -> LogScan:
    """Simulate a whole log by the published scanner, equal steps all round; the caller keeps the truth on the grid."""
    geometry = FanBeamGeometry(SCANNER, TRUE_THETA, (np.arange(views) + 0.5) * TAU / views)
    lines = log.sinograms(geometry, noise=noise)
    return LogScan(str(log.seed), Projector(geometry, grid), lines, truth, log)
