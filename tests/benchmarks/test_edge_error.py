import numpy as np
import pytest
from edge_error import edge_error_mm


def body(size=128, *, shift=0.0, knot=1.0):
    """A disc with a denser knot; the knot moved along x by `shift` pixels."""
    x = np.arange(size) - 0.5 * (size - 1)
    fine = np.zeros((size, size))
    for dx in (-0.375, -0.125, 0.125, 0.375):
        for dy in (-0.375, -0.125, 0.125, 0.375):
            px, py = (x + dx)[:, None], (x + dy)[None, :]
            fine += np.hypot(px, py) < 50.0
            fine += knot * (np.hypot(px - 10.0 - shift, py) < 15.0)
    return fine / 16.0


def test_outlines_in_place_have_no_edge_error():
    # The outline is read between pixels, at steps of an eighth.
    assert edge_error_mm(body(), body(), 2.0) < 2.0 * 0.15


def test_a_knot_out_of_place_is_measured_in_mm():
    """Moved by s, a circle's outline is displaced by s cos(angle) along its normal: s / sqrt(2) in the mean square."""
    outline = 15.0 / (15.0 + 50.0)
    error = edge_error_mm(body(shift=3.0), body(), 2.0)
    assert error == pytest.approx(2.0 * 3.0 / np.sqrt(2.0) * np.sqrt(outline), rel=0.2)
    assert edge_error_mm(body(shift=1.0), body(), 2.0) < error


def test_a_missing_knot_counts_as_out_of_reach_and_an_even_truth_has_no_outline():
    outline = 15.0 / (15.0 + 50.0)
    assert edge_error_mm(body(knot=0.0), body(), 1.5) == pytest.approx(1.5 * 5.0 * np.sqrt(outline), rel=0.15)
    assert edge_error_mm(np.zeros((32, 32)), np.ones((32, 32)), 1.0) == 0.0
