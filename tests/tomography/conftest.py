"""The published scanner, where its data lie, and angles all round the turn."""

# ruff: noqa: F811 - fixtures of this file ask for the one that is imported

import math
from collections.abc import Callable

import h5py
import numpy as np
import pytest
import scipy.io
from scan_files import published_data  # noqa: F401 - a fixture

from sawmill_tomography.geometry.geometry import FloatArray, Scanner, Theta

TAU = 2.0 * math.pi


@pytest.fixture(scope="session")
def scanner():
    return Scanner(source_to_cor_mm=859.46, num_detector_pixels=768, detector_pitch_mm=1154.2 / 768)


@pytest.fixture(scope="session")
def theta():
    return Theta(2.55023549, 714.683839, 319.943788, 43.6514375, 0.280799451)


@pytest.fixture(scope="session")
def full_turn() -> Callable[[int], FloatArray]:
    """View k of n at (k + 1/2) / n of a turn."""
    return lambda views: (np.arange(views) + 0.5) * TAU / views


@pytest.fixture(scope="session")
def irregular_turn() -> Callable[[int, int], FloatArray]:
    """Views all round, gaps differing by up to a factor of two, in no order."""

    def angles(views: int, seed: int) -> FloatArray:
        rng = np.random.default_rng(seed)
        gaps = rng.uniform(1.0, 2.0, views)
        return rng.permutation(np.cumsum(gaps) * TAU / gaps.sum())

    return angles


@pytest.fixture(scope="session")
def random_thetas() -> Callable[[int, int], list[Theta]]:
    """Thetas inside the published bounds whose frame exists, tilts and shifts of both signs."""

    def draw(count: int, seed: int) -> list[Theta]:
        rng = np.random.default_rng(seed)
        low = [0.0, 500.0, -500.0, -500.0, -1.0]
        high = [TAU, 1000.0, 500.0, 500.0, 1.0]
        drawn = (Theta.from_vector(rng.uniform(low, high)) for _ in range(100 * count))
        # Beyond 50 degrees the corners of the bounds put the detector between source and centre of rotation.
        kept = (t for t in drawn if abs(math.atan(t.detector_tilt) - math.atan2(t.source_shift_mm, 859.46)) < 0.87)
        return [next(kept) for _ in range(count)]

    return draw


@pytest.fixture(scope="session")
def l_phantom_sinogram(published_data):
    return scipy.io.loadmat(published_data / "l-phantom" / "sinogram.mat")["arr"].astype(np.float64)


@pytest.fixture(scope="session")
def log_sinogram(published_data):
    return np.load(published_data / "log-phantom" / "sinogram.npy", allow_pickle=False)


@pytest.fixture(scope="session")
def log_truth(published_data):
    with h5py.File(published_data / "log-phantom" / "truth.mat") as file:
        return file["logPhan"][()]
