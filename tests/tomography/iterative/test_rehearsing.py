import numpy as np
import pytest

from sawmill_worker.tomography.geometry import FanBeamGeometry, Scanner, Theta
from sawmill_worker.tomography.image_grid import ImageGrid
from sawmill_worker.tomography.iterative.holding_out import bottom
from sawmill_worker.tomography.iterative.penalised import Prior
from sawmill_worker.tomography.iterative.rehearsing import Rehearsal
from sawmill_worker.tomography.phantom import Disc, Phantom
from sawmill_worker.tomography.projector import Projector

SIZE, NOISE = 32, 0.05
LOG = Phantom("log", (Disc((0.0, 10.0), 130.0, 0.015), Disc((20.0, -10.0), 50.0, 0.006)))


@pytest.fixture
def rehearsal(irregular_turn):
    geometry = FanBeamGeometry(Scanner(860.0, 96, 10.5), Theta(0.4, 700.0, 80.0, 20.0, 0.1), irregular_turn(18, 1301))
    projector = Projector(geometry, ImageGrid(SIZE, 400.0))
    known = LOG.rasterise(SIZE, 400.0)
    noise = NOISE * np.random.default_rng(1302).standard_normal(geometry.sinogram_shape)
    scan = (projector.forward(known) + noise).astype(np.float32)
    return Rehearsal.of(projector, scan, np.full((1, 1), NOISE), known, non_negative=True)


def tried(rehearsal, factors):
    factors = np.asarray(factors)
    weights = np.broadcast_to(1.0 / (factors[:, None, None] * NOISE) ** 2, (factors.size, 18, 96)).astype(np.float32)
    scale = np.full(factors.size, 0.004)
    return rehearsal.try_out(weights, Prior("cauchy", scale, np.full(factors.size, 1.5), scale))


def test_the_imitation_is_the_known_log_with_the_noise_of_the_scan(rehearsal):
    drawn = rehearsal.lines[1] - rehearsal.projector.forward(rehearsal.known)
    # 1728 rays tell a standard deviation to 1.7 %.
    assert drawn.std() == pytest.approx(NOISE, rel=0.06)
    scan = rehearsal.lines[0] - rehearsal.projector.forward(rehearsal.known)
    assert abs(np.corrcoef(drawn.ravel(), scan.ravel())[0, 1]) < 0.1


def test_candidates_are_worth_their_distance_from_the_known_log(rehearsal):
    factors = (0.1, 1.0, 30.0)
    found = tried(rehearsal, factors)
    off = ((found.images - rehearsal.known).astype(np.float64) ** 2).sum(axis=(2, 3))
    np.testing.assert_allclose(found.errors, np.log(off[:, 0] * off[:, 1]), rtol=1e-6)
    # Noise that is trusted and data that are not are both worse than the truth.
    assert np.argmin(found.errors) == 1
    alone = tried(rehearsal, factors[1:2])
    # Blocks are projected in another order of sums than one image: single precision over ten iterations.
    assert alone.errors[0] == pytest.approx(found.errors[1], abs=0.02)


def test_the_bottom_of_a_parabola_in_the_logarithm_is_found():
    candidates = np.geomspace(0.5, 8.0, 5)
    errors = 0.3 + 0.7 * np.log(candidates / 1.7) ** 2
    assert bottom(candidates, errors) == pytest.approx((1.7, 0.3))
    assert bottom(candidates, -candidates) == (8.0, -8.0)
    assert bottom(candidates, candidates) == (0.5, 0.5)
