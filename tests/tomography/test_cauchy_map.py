import numpy as np
import pytest

from sawmill_tomography.geometry.geometry import FanBeamGeometry, Scanner, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.phantom import Disc, Phantom, Polygon
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_tomography.reconstruction.cauchy_map import cauchy_map
from sawmill_tomography.reconstruction.quality import relative_error

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("one_thread")]

LOG = Phantom(
    "log of two zones with a knot",
    (
        Disc((5.0, -8.0), 130.0, 0.018),
        Disc((0.0, 0.0), 80.0, -0.006),
        Polygon(((20.0, -10.0), (110.0, 20.0), (105.0, 50.0), (15.0, 10.0)), 0.008),
    ),
)


def test_the_preset_paper_is_the_published_objective_and_has_no_bound(irregular_turn):
    """1/2 |(A x - y) / 0.3|^2 + 3/2 sum log(1 + |d|^2 / 0.01^2), the corner's scale 0.1; at most 150 iterations."""
    scanner, theta = Scanner(860.0, 192, 1000.0 / 192), Theta(0.7, 700.0, 150.0, 60.0, 0.15)
    a = Projector(FanBeamGeometry(scanner, theta, irregular_turn(20, 1101)), ImageGrid(64, 400.0))
    lines = 20.0 * simulate_sinogram(
        LOG, a.geometry, noise=0.02, seed=1102
    )  # in the unit of that log, whose wood is about 0.4
    found = cauchy_map(a, lines, preset="paper")
    x = found.image.astype(float)
    squares = np.diff(x, axis=0)[:, :-1] ** 2 + np.diff(x, axis=1)[:-1] ** 2
    prior = np.log1p(squares / 0.01**2).sum() + np.log1p((x[-1, -1] / 0.1) ** 2)
    data = 0.5 * (((a.forward(found.image) - lines) / 0.3) ** 2).sum()
    assert found.objective[0] == pytest.approx(data + 1.5 * prior, rel=1e-4)
    assert found.iterations[0] <= 150
    assert x.min() < -0.01


@pytest.mark.parametrize(("views", "binned", "most"), [(20, 1, 0.145), (45, 2, 0.114)])
def test_the_published_log_with_nothing_given(scanner, theta, full_turn, log_sinogram, log_truth, views, binned, most):
    """As it is from few views; from more, at half the cells and pixels."""
    step, size, cells = 360 // views, 256 // binned, 768 // binned
    coarse = Scanner(scanner.source_to_cor_mm, cells, binned * scanner.detector_pitch_mm)
    a = Projector(FanBeamGeometry(coarse, theta, full_turn(360)[::step]), ImageGrid(size, 400.0))
    found = cauchy_map(a, log_sinogram[::step].reshape(views, cells, binned).mean(axis=2))
    assert relative_error(found.image, log_truth.reshape(size, binned, size, binned).mean(axis=(1, 3))) < most
    # The published noise is 1.58 in every column.
    assert found.noise == pytest.approx(1.58 / binned**0.5, rel=0.08)
    assert 0.8 < found.misfit[0] < 1.3
