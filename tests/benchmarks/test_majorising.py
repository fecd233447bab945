import numpy as np
import pytest
from majorising import Counted, memory_gradient, reweighted

from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, Scanner, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.reconstruction.iterative.descent import minimise
from sawmill_tomography.reconstruction.iterative.penalised import InverseCurvature, Objective
from sawmill_tomography.reconstruction.iterative.priors import CauchyPrior


@pytest.fixture
def objective():
    """Convex wherever a descent goes: the prior's scale is far above the differences of the image."""
    geometry = FanBeamGeometry(Scanner(860.0, 64, 18.0), Theta(0.3, 700.0, 100.0, 20.0, 0.1), np.arange(12) * TAU / 12)
    projector = Counted(geometry, ImageGrid(24, 300.0))
    image = np.zeros((1, 24, 24), np.float32)
    image[0, 6:17, 8:18] = 0.4
    lines = projector.forward(image) + np.random.default_rng(1401).standard_normal((1, 12, 64)).astype(np.float32)
    prior = CauchyPrior(np.array([4.0]), np.array([1.5]), np.array([4.0]))
    return Objective(projector, lines, np.ones_like(lines), prior)


def test_the_rivals_find_the_minimum_that_the_quasi_newton_descent_finds(objective):
    start = np.full((1, 24, 24), 0.2, np.float32)
    preconditioner = InverseCurvature(objective)
    settings = {"iterations": 300, "tolerance": 1e-9}
    lowest = minimise(objective, start, lower=0.0, **settings, preconditioner=preconditioner).values[0]
    for call in (
        memory_gradient(objective, start, iterations=150, memory=1),
        reweighted(objective, start, iterations=30, inner=6),
    ):
        values = [value for _, _, value in call.track]
        # Single precision leaves some 1e-6 of the objective.
        assert min(values) == pytest.approx(lowest, rel=1e-4)
        assert values[0] > 1.5 * lowest
        used = [used for _, used, _ in call.track]
        assert used == sorted(used)
        assert used[-1] > used[0]
