import numpy as np
import pytest

from sawmill_tomography.reconstruction.iterative import _descent_numba as kernels
from sawmill_tomography.reconstruction.iterative.descent import MEMORY, minimise


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
    found = minimise(
        objective,
        np.full((2, 4, 4), 9.0, np.float32),
        lower=0.0,
        iterations=3,
        tolerance=1e-9,
        on_iteration=lambda done, most: seen.append((done, most)),
    )
    assert not found.converged.any()
    assert found.iterations.tolist() == [3, 3]
    assert seen == [(1, 3), (2, 3), (3, 3)]
    assert found.remarks == ("2 of 2 slices were still improving when the iterations ran out: allow more",)


@pytest.mark.parametrize("lower", [0.0, -np.inf])
def test_the_objective_never_rises(lower):
    values = []

    def objective(images, _which):
        value = np.sum(np.log1p((images - 3.0) ** 2), axis=(1, 2), dtype=np.float64)
        return value, (2.0 * (images - 3.0) / (1.0 + (images - 3.0) ** 2))

    start = np.random.default_rng(1003).uniform(-5.0, 20.0, (1, 8, 8)).astype(np.float32)
    for iterations in (1, 4, 16, 64):
        found = minimise(objective, start, lower=lower, iterations=iterations, tolerance=0.0)
        values.append(found.values[0])
    assert values == sorted(values, reverse=True)
    assert values[-1] < 0.5 * values[0]


def test_a_preconditioner_saves_iterations():
    rng = np.random.default_rng(1004)
    stiffness = np.geomspace(1.0, 1e4, 64).reshape(1, 8, 8).astype(np.float32)
    centre = rng.uniform(1.0, 2.0, (1, 8, 8)).astype(np.float32)

    def objective(images, _which):
        off = images - centre
        return 1.0 + np.sum(stiffness * off**2, axis=(1, 2), dtype=np.float64), 2.0 * stiffness * off

    class Inverse:
        def scaling(self, _images, _which):
            return np.sqrt(0.5 / stiffness)

        def smoothed(self, images, _which):
            return images

    def found(preconditioner):
        return minimise(
            objective, np.zeros_like(centre), lower=0.0, iterations=200, tolerance=1e-6, preconditioner=preconditioner
        )

    # The exact inverse needs one step, and then the iterations that show that nothing is left to gain.
    assert found(Inverse()).values[0] == pytest.approx(1.0, abs=1e-6)
    assert found(Inverse()).iterations[0] < 0.5 * found(None).iterations[0]


def test_a_problem_among_others_takes_the_steps_that_it_takes_alone():
    """Each has its own history, step length and end, whichever of the others shorten their steps or are done."""
    rng = np.random.default_rng(1005)
    centre = rng.standard_normal((3, 8, 8)).astype(np.float32)
    stiffness = (np.geomspace(1.0, 300.0, 64).reshape(8, 8) * np.array([1.0, 1e-3, 50.0])[:, None, None]).astype(
        np.float32
    )

    def objective(images, which):
        # Not convex: steps are shortened.
        off = stiffness[which] * (images - centre[which])
        value = np.sum(np.log1p(off**2), axis=(1, 2), dtype=np.float64)
        return value, 2.0 * stiffness[which] * off / (1.0 + off**2)

    def found(which):
        return minimise(
            lambda images, inner: objective(images, which[inner]),
            np.zeros((which.size, 8, 8), np.float32),
            lower=0.0,
            iterations=60,
            tolerance=1e-3,
        )

    together = found(np.arange(3))
    assert len(set(together.iterations.tolist())) > 1
    for problem in range(3):
        alone = found(np.array([problem]))
        assert alone.iterations[0] == together.iterations[problem]
        np.testing.assert_array_equal(alone.images[0], together.images[problem])


def test_a_direction_is_that_of_the_two_loop_recursion():
    rng, memory, pixels = np.random.default_rng(5), MEMORY, 10_000
    matrix = rng.uniform(0.5, 2.0, pixels)
    x, gradient = rng.normal(size=(2, 1, pixels)).astype(np.float32)
    steps, changes = np.empty((2, 1, memory, pixels), np.float32)
    products = np.ones((1, memory, memory))
    used, newest, every = np.zeros(1, np.int64), np.full(1, memory - 1), np.arange(1)
    pairs = []
    for _ in range(memory + 2):  # more than the ring holds
        moved = x + rng.normal(size=x.shape).astype(np.float32)
        slope = (gradient + matrix * (moved - x)).astype(np.float32)
        pairs.append(((moved - x)[0].astype(np.float64), (slope - gradient)[0].astype(np.float64)))
        kernels.accept(every, every, moved, slope, x, gradient, newest, steps, changes, products, used)
    scaling, rings = np.ones_like(x), (steps, changes, products, used, newest, np.zeros((1, memory)))
    direction = np.empty_like(x)
    kernels.first_recursion(every, x, gradient, -np.inf, scaling, *rings, direction)
    kernels.second_recursion(every, x, gradient, -np.inf, scaling, np.ones(1), *rings, direction)

    # Nocedal and Wright 2006, algorithm 7.4.
    q, taken = gradient[0].astype(np.float64), []
    for s, y in reversed(pairs[-memory:]):
        taken.append(s @ q / (s @ y))
        q -= taken[-1] * y
    for s, y in pairs[-memory:]:
        q += (taken.pop() - y @ q / (s @ y)) * s
    # Single precision of inner products of ten thousand.
    np.testing.assert_allclose(direction[0], -q, atol=1e-4 * np.abs(q).max())
