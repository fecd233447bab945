import math

import numpy as np
import pytest

from sawmill_tomography.calibration.search.initial_guesses import random_guesses, shadow_extent, shadow_guesses
from sawmill_tomography.geometry.geometry import to_vector
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells

RADIUS = 120.0


@pytest.fixture
def frame(theta, scanner):
    return theta.source_frame(scanner.source_to_cor_mm)


def shadow_of(radius, r, sdd, u_c, tau):
    """Where the tangents from the source to a disc around the centre of rotation meet the detector."""
    gamma = math.asin(radius / r)
    return tuple(u_c + sdd * math.sin(g) / math.cos(g + tau) for g in (-gamma, gamma))


def test_the_extent_is_the_shadow_of_the_phantom_s_circle(scanner, frame, full_turn):
    cells = DetectorCells.of(scanner, binned=4)
    sinogram = analytic.project(Phantom("disc", (Disc((0.0, 0.0), RADIUS),)), cells, frame, full_turn(30))
    sinogram += 5.0 + np.random.default_rng(1501).normal(0.0, 2.0, sinogram.shape)
    expected = shadow_of(RADIUS, *to_vector(frame)[1:])
    # Either end is rounded to cells, and a shadow starts to count at a share of its depth.
    np.testing.assert_allclose(shadow_extent(sinogram, cells), expected, atol=2.0 * cells.width_mm)


def test_every_guess_casts_the_shadow_that_was_seen():
    guesses = shadow_guesses((-450.0, 50.0), RADIUS, (860.0, 1000.0), np.random.default_rng(1502))
    assert len(guesses) >= 10
    for r, log_magnification, u_c, tau in guesses:
        assert 860.0 <= r <= 1000.0
        assert log_magnification > 0.0
        np.testing.assert_allclose(
            shadow_of(RADIUS, r, r * math.exp(log_magnification), u_c, tau), (-450.0, 50.0), atol=1e-9
        )


def test_guesses_are_seeded_and_lie_in_their_box():
    box = np.array([(860.0, 1000.0), (0.1, 1.8), (-500.0, 500.0), (-1.2, 1.2)])
    one, again, other = (random_guesses(box, 64, np.random.default_rng(seed)) for seed in (1503, 1503, 1504))
    np.testing.assert_array_equal(one, again)
    assert (one != other).any()
    assert ((one >= box[:, 0]) & (one <= box[:, 1])).all()
    # Quasi-random points fill every quarter of every range evenly.
    quarters = np.floor(4.0 * (one - box[:, 0]) / (box[:, 1] - box[:, 0]))
    assert all(((quarters == q).sum(axis=0) == 16).all() for q in range(4))
