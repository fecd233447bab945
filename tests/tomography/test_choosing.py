import math

import numpy as np
import pytest

from sawmill_worker.tomography.choosing import recommend
from sawmill_worker.tomography.geometry import TAU, FanBeamGeometry, Scanner, Theta
from sawmill_worker.tomography.noise import estimated_noise, photon_noise
from sawmill_worker.tomography.phantom import Disc, Phantom
from sawmill_worker.tomography.simulate import simulate_sinogram
from sawmill_worker.vocabulary import ReconstructionMethod

LOG = Phantom("log", (Disc((10.0, 0.0), 120.0, 0.018),))
SCANNER = Scanner(860.0, 256, 4.0)


def scan(angles, noise):
    geometry = FanBeamGeometry(SCANNER, Theta(0.3, 700.0, 50.0, 10.0, 0.05), angles)
    return geometry, simulate_sinogram(LOG, geometry, noise=noise, seed=1301)


@pytest.mark.parametrize(
    ("views", "turn", "noise", "method", "reason"),
    [
        (360, TAU, 0.01, ReconstructionMethod.FBP, "360 views all round with 1"),
        (45, TAU, 0.01, ReconstructionMethod.TOTAL_VARIATION, "45 views are fewer than the 180"),
        (360, TAU, 0.06, ReconstructionMethod.TOTAL_VARIATION, "the noise is"),
        (200, 0.6 * TAU, 0.01, ReconstructionMethod.TOTAL_VARIATION, "the 200 views leave a gap"),
    ],
)
def test_views_gaps_and_noise_decide_and_the_reason_is_given(views, turn, noise, method, reason):
    chosen = recommend(*scan(np.arange(views) * turn / views, noise))
    assert chosen.method is method
    assert reason in chosen.reason


def test_noise_is_estimated_with_and_without_air():
    _, sinogram = scan(np.arange(60) * TAU / 60, 0.02)
    _, clean = scan(np.arange(60) * TAU / 60, 0.0)
    noise = 0.02 * math.sqrt(float(np.mean(clean**2)))
    assert estimated_noise(sinogram.astype(np.float32)) == pytest.approx(noise, rel=0.1)
    inner = np.ascontiguousarray(sinogram[:, 100:156].astype(np.float32))
    # No air there: from second differences, which the log's own curvature raises a little.
    assert estimated_noise(inner) == pytest.approx(noise, rel=0.2)


def test_noise_free_data_are_not_trusted_without_limit():
    _, clean = scan(np.arange(60) * TAU / 60, 0.0)
    assert estimated_noise(clean.astype(np.float32)) == pytest.approx(0.002 * math.sqrt(np.mean(clean**2)), rel=1e-3)


def test_photon_noise_is_the_scatter_of_poisson_counts():
    counts = np.random.default_rng(1302).poisson(5000.0 * math.exp(-2.0), 200_000)
    scatter = float(np.std(-np.log(counts / 5000.0)))
    # The delta method, at 677 counts, is right to a part in 1000; the sample's own scatter is 0.2 %.
    np.testing.assert_allclose(photon_noise(np.full((2, 30), 2.0), 5000.0), scatter, rtol=0.01)
