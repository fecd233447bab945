"""What a residual holds beside noise, and where."""

import math

import numpy as np
import pytest

from sawmill_tomography.calibration.joint_fit.structure import ResidualPlace, find_structure

VIEWS, CELLS = 80, 200


@pytest.fixture
def model():
    """A smooth shadow with two sharp ends, which wanders over the detector as the phantom turns."""
    across = np.linspace(-1.0, 1.0, CELLS) - 0.2 * np.sin(2.0 * np.pi * np.arange(VIEWS) / VIEWS)[:, None]
    return 100.0 * np.where(np.abs(across) < 0.5, 1.0 + 0.2 * np.cos(3.0 * across), 0.0)


@pytest.fixture
def rng():
    return np.random.default_rng(1240)


def test_noise_is_no_structure_however_uneven(model, rng):
    uneven = rng.standard_normal(model.shape) * (1.0 + model / 20.0)
    share = find_structure(uneven, model).share
    # The mean of 16 000 products of unit noise scatters by 0.008, so its root by 0.09 of the noise.
    assert share < 0.2 * uneven.std() / model.std()


def test_a_pattern_s_share_is_its_size(model, rng):
    wave = np.sin(np.arange(CELLS) / 9.0)[None, :] * np.cos(np.arange(VIEWS) / 11.0)[:, None]
    found = find_structure(wave + 0.5 * rng.standard_normal(model.shape), model)
    assert found.share == pytest.approx(wave.std() / model.std(), rel=0.05)


@pytest.mark.parametrize(("share", "named"), [(0.045, False), (0.055, True)])
def test_cells_that_are_wrong_in_all_views_are_named(model, rng, share, named):
    wrong = np.zeros_like(model)
    wrong[:, 30:70] = share * model.std() * math.sqrt(CELLS / 40)
    found = find_structure(wrong + 0.05 * model.std() * rng.standard_normal(model.shape), model)
    assert (found.place is ResidualPlace.STANDING) == named
    assert found.cells == ({"first_cell": 30, "last_cell": 69} if named else {})


def test_what_turns_with_the_phantom_is_not_in_all_views(model):
    knots = 0.5 * model * (np.arange(CELLS) % 40 < 10) * np.cos(2.0 * np.pi * np.arange(VIEWS) / VIEWS)[:, None]
    assert find_structure(knots, model).place is not ResidualPlace.STANDING


def test_edges_inside_and_views_are_distinguished(model, rng):
    noise = 0.1 * rng.standard_normal(model.shape)
    edges = np.abs(np.diff(model, axis=1, prepend=0.0)) > 50.0
    assert find_structure(noise + 3.0 * edges, model).place is ResidualPlace.EDGES
    inside = np.zeros_like(model)
    inside[:, 90:110] = 1.0
    assert find_structure(noise + inside, model).place is ResidualPlace.SHADOW
    # Flat fields of few frames leave the same error in every view.
    unequal = np.broadcast_to(rng.standard_normal(CELLS), model.shape)
    assert find_structure(noise + unequal, model).place is ResidualPlace.CELLS
    moved = np.zeros_like(model)
    moved[[7, 31], 20:180] = 5.0
    assert find_structure(noise + moved, model).place is ResidualPlace.VIEWS
