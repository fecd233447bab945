"""Every kernel that makes an index of a float, with numbers that no scanner has: a process that may crash.

    python kernel_fuzz.py SEED ROUNDS

The checked functions in front of the kernels refuse most of these; here the kernels stand alone.
"""

import sys
from collections.abc import Callable
from contextlib import suppress

import numpy as np

from sawmill_tomography.phantoms.built_in import RECTANGLE_WITH_HOLE
from sawmill_tomography.projection import _analytic_numba as analytic
from sawmill_tomography.projection import _projector_numba as projector
from sawmill_tomography.reconstruction import _fbp_numba as fbp

VIEWS, CELLS, SIZE = 8, 24, 16
ODD = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, 1e-300, -1e-300, 1e300, -1e300, 2.0**31, -(2.0**31), 2.0**63])


class Numbers:
    """Seeded numbers of every size, and some that are none."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def __call__(self, *shape: int) -> np.ndarray:
        rng = self._rng
        ordinary = rng.uniform(-1000.0, 1000.0, shape)
        any_size = rng.choice([-1.0, 1.0], shape) * 10.0 ** rng.uniform(-300.0, 300.0, shape)
        kind = rng.random(shape)
        return np.where(kind < 0.5, ordinary, np.where(kind < 0.8, any_size, rng.choice(ODD, shape)))

    def one(self) -> float:
        return float(self())

    def some(self, count: int) -> list[float]:
        """Most of them ordinary, so that a single one gets far."""
        values = np.array([0.3, 860.0, 1600.0, 20.0, 0.1, 1.5, -200.0, -200.0, 25.0])[:count]
        wild = self._rng.random(count) < 0.4
        return [float(value) for value in np.where(wild, self(count), values)]


def call(kernel: Callable[..., None], *arguments: object) -> None:
    """An exception is no crash."""
    with suppress(ZeroDivisionError, ValueError, OverflowError):
        kernel(*arguments)


def back_project(numbers: Numbers) -> None:
    """All three, and what lays out their rows."""
    _, big_r, sdd, u_c, tau, pitch, low_x, low_y, pixel = numbers.some(9)
    beta = numbers(VIEWS)
    for power in (1, 2):
        frame = (beta, big_r, sdd, u_c, tau, pitch, low_x, low_y, pixel, power)
        pairs = np.empty((VIEWS, CELLS + 2, 2), np.float32)
        call(fbp.pair_up, np.ones((VIEWS, CELLS), np.float32), numbers(VIEWS), numbers(CELLS), pairs)
        gathered = pairs.view(np.uint64)[..., 0]
        call(fbp.back_project, gathered, *frame, np.empty((SIZE, SIZE), np.float32))
        filtered, weights = np.ones((VIEWS, 2, CELLS), np.float32), (numbers(VIEWS), numbers(CELLS))
        for kernel, lanes in ((fbp.back_project_4, 4), (fbp.back_project_16, 16)):
            rows = np.zeros((VIEWS, CELLS + 2, lanes), np.float32)
            call(fbp.lay_out, filtered, *weights, rows)
            call(kernel, rows, *frame, np.empty((2, SIZE, SIZE), np.float32))


def project(numbers: Numbers) -> None:
    source, centre, axis = numbers(VIEWS, 2), numbers(VIEWS, 2), numbers(VIEWS, 2)
    if numbers.one() > 0.0:
        source, centre = np.full((VIEWS, 2), (30.0, -860.0)), np.full((VIEWS, 2), (30.0, 700.0))
    positions, (half, pixel) = numbers(CELLS), (abs(value) for value in numbers.some(9)[7:])
    for lanes, forward, adjoint in (
        (1, projector.forward_1, projector.adjoint_1),
        (4, projector.forward_4, projector.adjoint_4),
        (16, projector.forward_16, projector.adjoint_16),
    ):
        pixels = (SIZE + projector.BORDER) ** 2 * lanes
        lines = np.zeros((lanes, 1, VIEWS, CELLS), np.float32)
        call(forward, np.ones(pixels, np.float32), SIZE, source, centre, axis, positions, half, pixel, lines)
        call(adjoint, lines, SIZE, source, centre, axis, positions, half, pixel, np.empty((2, pixels), np.float32))


def shadow(numbers: Numbers) -> None:
    """The analytic projections and what least squares needs of them."""
    edges, discs = RECTANGLE_WITH_HOLE.edges, RECTANGLE_WITH_HOLE.discs
    psi, big_r, sdd, u_c, tau, pitch, first, *_ = numbers.some(9)
    if numbers.one() > 500.0:
        edges, discs = numbers(6, 5), numbers(2, 4)
    # Two modules of any geometry.
    frames = np.array([(0, 3, psi, big_r, sdd, u_c, tau, *numbers(8)), (3, CELLS, psi, big_r, *numbers(11))])
    t_x, t_y = 0.01 * numbers(VIEWS), 0.01 * numbers(VIEWS)
    for rays in (0, 2):
        arguments = (edges, discs, frames, t_x, t_y, numbers(VIEWS), first, pitch, rays)
        gram = (*arguments, np.ones((VIEWS, CELLS)), np.empty((0, 0)), np.empty((VIEWS, 10, 10)))
        out = np.empty((VIEWS, CELLS))
        for kernel, given in (
            (analytic.project, (*arguments, out)),
            (analytic.project_in_one_thread, (*arguments, out)),
            (analytic.project_with_deformations, (*arguments, np.empty((12, VIEWS, CELLS)))),
            (analytic.gram, gram),
            (analytic.gram_in_one_thread, gram),
        ):
            call(kernel, *given)


def main() -> None:
    seed, rounds = (int(argument) for argument in sys.argv[1:])
    numbers = Numbers(seed)
    for _ in range(rounds):
        back_project(numbers)
        project(numbers)
        shadow(numbers)


if __name__ == "__main__":
    main()
