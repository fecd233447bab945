"""Values of the vocabulary: a polygon's sides against a comparison of every pair, u_c and tau with their errors."""

import math
import random
import time

import numpy as np
import pytest

from sawmill_contracts.phantoms import BUILT_IN_PHANTOMS
from sawmill_vocabulary import DetectorEstimate, Polygon, fault_of_outline


def turn(a, b, c):
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def is_between(a, b, point):
    return turn(a, b, point) == 0 and all(min(a[k], b[k]) <= point[k] <= max(a[k], b[k]) for k in (0, 1))


def meet(a, b, c, d):
    """Whether two sides share a point; exact, for corners that are whole numbers."""
    crossing = turn(a, b, c) * turn(a, b, d) < 0 and turn(c, d, a) * turn(c, d, b) < 0
    return crossing or is_between(a, b, c) or is_between(a, b, d) or is_between(c, d, a) or is_between(c, d, b)


def is_no_outline(corners):
    count = len(corners)
    sides = [(corner, corners[(i + 1) % count]) for i, corner in enumerate(corners)]
    for i in range(count):
        (before, corner), (_, after) = sides[i - 1], sides[i]
        if is_between(before, corner, after) or is_between(corner, after, before):
            return True
        if any(meet(*sides[i], *sides[j]) for j in range(i) if (i - j) % count not in {1, count - 1}):
            return True
    return False


def test_every_crossing_is_found_and_no_other():
    """On grids of few points, where sides touch, lie on each other and are upright far more often than in drawings."""
    draw = random.Random(4)  # noqa: S311 - of a test
    outcomes = []
    for _ in range(3000):
        size = draw.choice([2, 3, 5, 1000])
        corners = [(float(draw.randint(0, size)), float(draw.randint(0, size))) for _ in range(draw.randint(3, 8))]
        if draw.random() < 0.5:
            corners.sort(key=lambda corner: math.atan2(corner[1] - size / 2, corner[0] - size / 2))
        outcomes.append(is_no_outline(corners))
        assert (fault_of_outline(corners) is not None) == outcomes[-1], corners
    assert 0.2 < sum(outcomes) / len(outcomes) < 0.9


@pytest.mark.parametrize("lie", [lambda x, y: (x, y), lambda x, y: (y, x), lambda x, y: (x + y, x - y)])
def test_the_time_for_20_000_corners_does_not_grow_with_their_pairs(lie):
    # Teeth that all lie on one height: every side is beside every other.
    comb = [*((0.01 * i, 100.0 * (i % 2)) for i in range(19_998)), (200.0, -5.0), (-5.0, -5.0)]
    corners = [lie(x, y) for x, y in comb]
    begun = time.process_time()
    assert fault_of_outline(corners) is None
    crossing = [*corners[:9_000], corners[9_002], corners[9_001], corners[9_000], *corners[9_003:]]
    assert "crosses itself" in fault_of_outline(crossing)
    # Processor seconds: 0.16 s each at the most on a slow core, and minutes for every pair of sides.
    assert time.process_time() - begun < 10.0


def test_the_built_in_outlines_are_outlines():
    shapes = [shape for drawing in BUILT_IN_PHANTOMS.values() for shape in drawing.shapes]
    outlines = [shape.vertices_mm for shape in shapes if isinstance(shape, Polygon)]
    assert outlines
    assert [fault_of_outline(corners) for corners in outlines] == [None] * len(outlines)


def test_an_estimate_is_a_value_whatever_its_numbers_came_in():
    plain = DetectorEstimate(0.1, 0.002, ((0.25, 0.1), (0.1, 0.16)))
    assert DetectorEstimate.of(np.array([0.1, 0.002]), np.array(plain.covariance)) == plain
    assert DetectorEstimate.of([0.1, 0.002], [[0.25, 0.1], [0.1, 0.16]]) == plain
    assert (plain.values, plain.deviations) == ((0.1, 0.002), (0.5, 0.4))
    with pytest.raises(ValueError, match="2 values with a covariance of 2 x 2"):
        DetectorEstimate.of([0.1, 0.002], np.eye(3))


@pytest.mark.parametrize(
    ("covariance", "relative"),
    [
        (((4.0, 0.0), (0.0, 1e-6)), 1.0),
        (((4.0, 1.2), (1.2, 1.0)), 0.64),
        (((1.0, 1.0), (1.0, 1.0)), 0.0),
        (((1.0, 2.0), (2.0, 1.0)), -3.0),
        (((0.0, 0.0), (0.0, 1.0)), 0.0),
        (((-1.0, 0.0), (0.0, -1.0)), 0.0),
        (((math.inf, 0.0), (0.0, 1.0)), 0.0),
        (((1.0, math.nan), (math.nan, 1.0)), 0.0),
    ],
)
def test_a_covariance_without_an_inverse_has_no_positive_determinant(covariance, relative):
    assert DetectorEstimate(0.1, 0.002, covariance).relative_determinant == pytest.approx(relative)
