import numpy as np
import pytest

from sawmill_tomography.geometry.geometry import FanBeamGeometry, Scanner, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.iterative.priors import CauchyPrior
from sawmill_tomography.reconstruction.iterative.synthetic_tuning import SyntheticTuning

pytestmark = pytest.mark.slow

SIZE, NOISE = 32, 0.05
LOG = Phantom("log", (Disc((0.0, 10.0), 130.0, 0.015), Disc((20.0, -10.0), 50.0, 0.006)))


@pytest.fixture
def tuning(irregular_turn):
    geometry = FanBeamGeometry(Scanner(860.0, 96, 10.5), Theta(0.4, 700.0, 80.0, 20.0, 0.1), irregular_turn(18, 1301))
    projector = Projector(geometry, ImageGrid(SIZE, 400.0))
    reference = LOG.rasterise(SIZE, 400.0)
    noise = NOISE * np.random.default_rng(1302).standard_normal(geometry.sinogram_shape)
    scan = (projector.forward(reference) + noise).astype(np.float32)
    return SyntheticTuning.of(projector, scan, np.full((1, 1), NOISE), reference, non_negative=True)


def errors_of(tuning, factors):
    factors = np.asarray(factors)
    weights = np.broadcast_to(1.0 / (factors[:, None, None] * NOISE) ** 2, (factors.size, 18, 96)).astype(np.float32)
    scale = np.full(factors.size, 0.004)
    return tuning.errors(weights, CauchyPrior(scale, np.full(factors.size, 1.5), scale))


def test_the_synthetic_scan_shows_the_reference_with_the_noise_of_the_scan(tuning):
    drawn = tuning.lines[1] - tuning.projector.forward(tuning.reference)
    # 1728 rays give a standard deviation to 1.7 %.
    assert drawn.std() == pytest.approx(NOISE, rel=0.06)
    scan = tuning.lines[0] - tuning.projector.forward(tuning.reference)
    assert abs(np.corrcoef(drawn.ravel(), scan.ravel())[0, 1]) < 0.1


def test_the_error_of_a_candidate_is_its_distance_from_the_reference(tuning):
    factors = (0.1, 1.0, 30.0)
    found = errors_of(tuning, factors)
    off = ((found.images - tuning.reference).astype(np.float64) ** 2).sum(axis=(2, 3))
    np.testing.assert_allclose(found.errors, np.log(off[:, 0] * off[:, 1]), rtol=1e-6)
    # A sigma far too small and one far too large are both worse than the right one.
    assert np.argmin(found.errors) == 1
    alone = errors_of(tuning, factors[1:2])
    # Blocks are projected in another order of sums than one image: single precision over ten iterations.
    assert alone.errors[0] == pytest.approx(found.errors[1], abs=0.02)
