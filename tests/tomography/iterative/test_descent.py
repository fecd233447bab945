import numpy as np
import pytest

from sawmill_tomography.reconstruction.iterative.descent import minimise


def test_a_bound_cuts_the_minimum_of_independent_pixels():
    """The minimum of sum s (x - c)^2 over x >= 0 is max(c, 0), for problems that differ ten thousandfold in scale."""
    rng = np.random.default_rng(1001)
    centre = rng.standard_normal((3, 12, 12)).astype(np.float32)
    stiffness = (rng.uniform(0.5, 20.0, (3, 12, 12)) * np.array([0.01, 1.0, 100.0])[:, None, None]).astype(np.float32)

    def objective(images, which):
        off = images - centre[which]
        return np.sum(stiffness[which] * off**2, axis=(1, 2), dtype=np.float64), 2.0 * stiffness[which] * off

    found = minimise(objective, np.zeros_like(centre), lower=0.0, iterations=200, tolerance=1e-9)
    # Single precision of the objective leaves sqrt(1e-7) of the pixels' size.
    np.testing.assert_allclose(found.images, np.maximum(centre, 0.0), atol=2e-3)
    assert found.converged.all()
    assert found.remarks == ()


def test_coupled_pixels_reach_the_solution_of_the_linear_system():
    rng = np.random.default_rng(1002)
    factor = rng.standard_normal((36, 36))
    matrix = factor @ factor.T / 36.0 + 0.3 * np.eye(36)
    right = rng.standard_normal(36)

    def objective(images, which):
        assert which.tolist() == [0]
        x = images.reshape(36).astype(np.float64)
        value, slope = 0.5 * x @ matrix @ x - right @ x, matrix @ x - right
        return np.array([value]), slope.reshape(1, 6, 6).astype(np.float32)

    found = minimise(objective, np.zeros((1, 6, 6), np.float32), lower=-np.inf, iterations=200, tolerance=1e-9)
    lowest = -0.5 * right @ np.linalg.solve(matrix, right)
    # Steps that gain less than single precision shows are accepted and end the descent.
    assert found.values[0] == pytest.approx(lowest, rel=1e-5)


def test_running_out_of_iterations_is_reported():
    def objective(images, _which):
        return np.sum((images - 1.0) ** 4, axis=(1, 2), dtype=np.float64), 4.0 * (images - 1.0) ** 3

    seen = []
    limits = {"lower": 0.0, "iterations": 3, "tolerance": 1e-9}
    start = np.full((2, 4, 4), 9.0, np.float32)
    found = minimise(objective, start, **limits, on_iteration=lambda done, most: seen.append((done, most)))
    assert not found.converged.any()
    assert found.iterations.tolist() == [3, 3]
    assert seen == [(1, 3), (2, 3), (3, 3)]
    assert found.remarks == ("2 of 2 slices were still improving when the iterations ran out: allow more",)


@pytest.mark.parametrize("lower", [0.0, -np.inf])
def test_the_objective_never_rises(lower):
    def objective(images, _which):
        value = np.sum(np.log1p((images - 3.0) ** 2), axis=(1, 2), dtype=np.float64)
        return value, (2.0 * (images - 3.0) / (1.0 + (images - 3.0) ** 2))

    start = np.random.default_rng(1003).uniform(-5.0, 20.0, (1, 8, 8)).astype(np.float32)
    found = [minimise(objective, start, lower=lower, iterations=most, tolerance=0.0) for most in (1, 4, 16, 64)]
    values = [descent.values[0] for descent in found]
    assert values == sorted(values, reverse=True)
    assert values[-1] < 0.5 * values[0]
