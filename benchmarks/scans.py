"""The published scans where they are present, simulated ones of the same scanner, and what a geometry does to a log."""

import math
import os
from functools import cache
from pathlib import Path
from typing import Literal

import h5py
import numpy as np
from scanners import SCANNER
from scipy.io import loadmat

from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, FloatArray, Scanner, SourceFrame, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.geometry.ray_error import ray_error, scale_ray_error
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_tomography.reconstruction.fbp import fbp
from sawmill_tomography.reconstruction.quality import relative_error, structural_similarity_index
from sawmill_vocabulary import Rotation

Source = Literal["published", "simulated"]

TRUE_THETA = Theta(2.55023549, 714.683839, 319.943788, 43.6514375, 0.280799451)
TRUE_FRAME = TRUE_THETA.source_frame(SCANNER.source_to_cor_mm)
ANGLES = (np.arange(360) + 0.5) * TAU / 360
LOG_NOISE = 0.02
GRID = ImageGrid(256, 400.0)


def rotated_ray_error_mm(frame: SourceFrame, scanner: Scanner) -> float:
    """Compute the RMS ray error, mm, of a geometry against the true one, up to one rotation alone."""
    error = ray_error(SCANNER, TRUE_FRAME, frame, other_scanner=scanner)
    return math.hypot(error.rms_mm, scale_ray_error(SCANNER, TRUE_FRAME, error.scale_change))


def published_folder() -> Path | None:
    """Return the folder of the published data: SAWMILL_PUBLISHED_DATA or next to the project; None if it is absent."""
    folder = Path(os.environ.get("SAWMILL_PUBLISHED_DATA", "../shared/data"))
    return folder if (folder / "l-phantom" / "sinogram.mat").is_file() else None


def sources() -> tuple[Source, ...]:
    """List the kinds of data that this machine has."""
    return ("simulated",) if published_folder() is None else ("published", "simulated")


def _published(name: str) -> Path:
    folder = published_folder()
    if folder is None:
        raise FileNotFoundError("no published data: name their folder in SAWMILL_PUBLISHED_DATA")
    return folder / name


def published_l_phantom() -> FloatArray:
    """Read the published L-phantom's sinogram, (360, 768), one ray a cell, no noise."""
    return np.asarray(loadmat(_published("l-phantom/sinogram.mat"))["arr"], np.float64)


def simulated(phantom: Phantom, *, noise: float, seed: int, angles: FloatArray = ANGLES) -> FloatArray:
    """Simulate a scan with the published theta, (views, 768), noise relative to its RMS."""
    return simulate_sinogram(phantom, FanBeamGeometry(SCANNER, TRUE_THETA, angles), noise=noise, seed=seed)


@cache
def log_sinogram(source: Source) -> FloatArray:
    """Return a log with 360 views, (360, 768): the published one, or a simulated one with as much noise."""
    if source == "published":
        return np.asarray(np.load(_published("log-phantom/sinogram.npy"), allow_pickle=False), np.float64)
    return simulated(LogModel.random(1).slice_at(180.0), noise=LOG_NOISE, seed=1)


def log_truth(source: Source) -> FloatArray:
    """Return the log itself on the grid of the images, [x, y]."""
    if source == "simulated":
        return LogModel.random(1).slice_at(180.0).rasterise(GRID.size, GRID.field_mm).astype(np.float64)
    with h5py.File(_published("log-phantom/truth.mat")) as file:
        return np.asarray(file["logPhan"], np.float64)


def log_image(source: Source, theta: Theta, rotation: Rotation = Rotation.AS_GIVEN) -> Image:
    """Reconstruct the log by FBP (256, 256) from all 360 views with a geometry."""
    geometry = FanBeamGeometry(SCANNER, theta, rotation.apply(ANGLES))
    return fbp(Projector(geometry, GRID), log_sinogram(source)).image


@cache
def reference_image(source: Source) -> Image:
    """Reconstruct the log by FBP with the true theta."""
    return log_image(source, TRUE_THETA)


def log_quality(source: Source, theta: Theta, rotation: Rotation = Rotation.AS_GIVEN) -> tuple[float, float]:
    """Compute relative error and SSIM of the log's FBP with a geometry, against its FBP with the true one."""
    image, reference = log_image(source, theta, rotation), reference_image(source)
    return relative_error(image, reference), structural_similarity_index(image, reference)
