"""A search that begins again recalls its evaluations and goes on as if it had not been ended."""

import numpy as np
import pytest
from scipy.optimize import Bounds, differential_evolution

from sawmill_tomography.calibration.recalling import Evaluations, RecallingObjective


def bowl(vector):
    return float(((vector - 0.3) ** 2).sum() + 0.1 * np.cos(9.0 * vector).sum())


def search(objective, seed=7):
    found = differential_evolution(
        objective, Bounds(-np.ones(3), np.ones(3)), mutation=(0.5, 1.0), maxiter=6, rng=np.random.default_rng(seed)
    )
    return found.x, found.population, found.population_energies, found.nfev


class Killed(Exception):  # noqa: N818 - what happened to it
    pass


def kill_after(count):
    left = iter(range(count))

    def on_computed(search):
        if next(left, None) is None:
            kept.append(search.evaluations())
            raise Killed

    kept = []
    return on_computed, kept


# In the first population, within a generation, in the last one, and in the polish.
@pytest.mark.parametrize("pause", [20, 61, 300, 330])
def test_a_search_killed_again_and_again_ends_at_the_same_place(pause):
    whole = RecallingObjective(bowl)
    right = search(whole)
    earlier, deaths = None, 0
    while True:
        computed, kept = kill_after(pause)
        again = RecallingObjective(bowl, earlier, computed)
        try:
            answer = search(again)
            break
        except Killed:
            (earlier,), deaths = kept, deaths + 1
            assert len(earlier.values) == deaths * (pause + 1)
    assert deaths == (whole.count - 1) // (pause + 1)
    for one, other in zip(answer, right, strict=True):
        np.testing.assert_array_equal(one, other)
    assert again.count == whole.count


def test_what_another_search_asked_is_not_recalled():
    first, second = RecallingObjective(bowl), RecallingObjective(bowl)
    search(first, seed=1)
    right = search(second, seed=2)
    asked = []
    misled = RecallingObjective(bowl, first.evaluations(), lambda search: asked.append(search.count))
    np.testing.assert_array_equal(search(misled, seed=2)[0], right[0])
    assert asked == list(range(1, second.count + 1))
    assert not misled.recalls


def test_values_without_vectors_are_refused():
    with pytest.raises(ValueError, match="a value for each vector"):
        Evaluations(np.zeros((3, 5)), np.zeros(4))
