"""Phantoms, and random logs."""

import math

import numpy as np
import pytest

from sawmill_tomography.phantoms.built_in import BUILT_IN, L_SHAPE, RECTANGLE_WITH_HOLE
from sawmill_tomography.phantoms.log_model import HEARTWOOD_PER_MM, METAL_PER_MM, SAPWOOD_PER_MM, LogModel
from sawmill_tomography.phantoms.phantom import Disc, Phantom, PhantomError, Polygon

L_AREA = 200.14 * 300.92 - 99.93 * 201.56
RECTANGLE_AREA = 200.14 * 300.36 - math.pi * 26.0**2
FIELD = 400.0


def area_of(image):
    return float(image.sum(dtype=np.float64)) * (FIELD / image.shape[0]) ** 2


@pytest.mark.parametrize(("phantom", "area"), [(L_SHAPE, L_AREA), (RECTANGLE_WITH_HOLE, RECTANGLE_AREA)])
@pytest.mark.parametrize("size", [200, 201])
def test_the_rasterised_area_is_the_drawn_one(phantom, area, size):
    # An outline of a metre, each of its points misplaced by half a sub-pixel (0.25 mm) at worst; in fact the sides
    # are misplaced by a constant each, so allow that for the two longest.
    assert area_of(phantom.rasterise(size, FIELD)) == pytest.approx(area, abs=600.0 * 0.25)
    # With ever finer samples the area converges on the drawn one.
    assert area_of(phantom.rasterise(size, FIELD, subsamples=16)) == pytest.approx(area, abs=600.0 * 0.0625)


def test_a_rasterised_disc_has_its_area_and_its_centre_of_mass():
    image = Phantom("disc", (Disc((31.0, -47.0), 60.0, 2.0),)).rasterise(256, FIELD)
    # Errors of single sub-pixels on the rim average out: below a thousandth of the area.
    assert area_of(image) == pytest.approx(2.0 * math.pi * 60.0**2, rel=1e-3)
    axis = (np.arange(256) + 0.5) * FIELD / 256 - FIELD / 2
    assert (image.sum(axis=1) @ axis) / image.sum() == pytest.approx(31.0, abs=0.02)
    assert (image.sum(axis=0) @ axis) / image.sum() == pytest.approx(-47.0, abs=0.02)


def test_a_hole_is_empty_and_densities_add_where_shapes_overlap():
    image = RECTANGLE_WITH_HOLE.rasterise(400, FIELD)
    assert (image[150, 151], image[200, 200], image[50, 200]) == (0.0, 1.0, 0.0)
    image = Phantom("two", (Disc((0.0, 0.0), 100.0, 0.25), Disc((0.0, 0.0), 50.0, 0.5))).rasterise(200, FIELD)
    assert (image[100, 100], image[100, 100 + 35]) == (0.75, 0.25)


def test_an_edge_pixel_holds_the_share_that_is_covered():
    half = Phantom("half", (Polygon(((-5.0, -5.0), (0.5, -5.0), (0.5, 5.0), (-5.0, 5.0))),))
    image = half.rasterise(10, 10.0, subsamples=4)
    np.testing.assert_array_equal(image[:5], 1.0)
    np.testing.assert_array_equal(image[5], 0.5)
    np.testing.assert_array_equal(image[6:], 0.0)


def test_mirroring_turns_the_columns_round_and_a_quarter_turn_the_image():
    np.testing.assert_array_equal(L_SHAPE.mirrored().rasterise(64, FIELD), L_SHAPE.rasterise(64, FIELD)[:, ::-1])
    for phantom in (L_SHAPE, RECTANGLE_WITH_HOLE):
        assert phantom.mirrored().mirrored() == phantom
        assert phantom.mirrored() != phantom
    # (x, y) -> (-y, x): at [i, j] stands what stood at [j, n - 1 - i].
    turned = L_SHAPE.rotated(math.pi / 2.0).rasterise(64, FIELD, subsamples=3)
    np.testing.assert_array_equal(turned, np.rot90(L_SHAPE.rasterise(64, FIELD, subsamples=3)))


def test_scaling_scales_lengths_and_the_radius_reaches_the_farthest_point():
    half = RECTANGLE_WITH_HOLE.scaled(0.5)
    np.testing.assert_array_equal(half.rasterise(64, FIELD / 2), RECTANGLE_WITH_HOLE.rasterise(64, FIELD))
    assert half.radius_mm == pytest.approx(RECTANGLE_WITH_HOLE.radius_mm / 2)
    assert half.discs[0, 2:].tolist() == [13.0, -1.0]
    assert L_SHAPE.radius_mm == pytest.approx(math.hypot(100.07, 150.88))
    assert Phantom("disc", (Disc((3.0, 4.0), 2.0),)).radius_mm == pytest.approx(7.0)


def test_edges_run_counter_clockwise_however_the_polygon_is_written():
    corners = L_SHAPE.shapes[0].vertices_mm
    for order in (corners, corners[::-1]):
        edges = Phantom("l", (Polygon(order),)).edges
        twice_area = float(np.sum(edges[:, 0] * edges[:, 3] - edges[:, 2] * edges[:, 1]))
        assert twice_area == pytest.approx(2.0 * L_AREA, rel=1e-12)


def test_outlines_are_closed_and_lie_on_the_shapes():
    polygon, circle = RECTANGLE_WITH_HOLE.outlines(points_per_disc=91)
    for line in (polygon, circle):
        np.testing.assert_allclose(line[0], line[-1], atol=1e-12)
    assert polygon.shape == (5, 2)
    assert circle.shape == (91, 2)
    np.testing.assert_allclose(np.hypot(*(circle - (-50.0, -49.0)).T), 26.0, rtol=1e-12)


def test_the_built_in_phantoms_are_the_published_ones():
    assert set(BUILT_IN) == {"l-shape", "rectangle-with-hole"}
    assert L_SHAPE.rasterise(400, FIELD)[100 + 20, 400 - 120] == 1.0
    # The missing corner of the L is at -x, -y.
    assert L_SHAPE.rasterise(400, FIELD)[100 + 20, 120] == 0.0


@pytest.mark.parametrize(
    ("shapes", "reason"),
    [
        ((Polygon(((0.0, 0.0), (1.0, 1.0))),), "at least three corners"),
        ((Polygon(((0.0, 0.0), (1.0, math.nan), (2.0, 0.0))),), "finite"),
        ((Polygon(((0.0, 0.0), (1.0, 1.0), (2.0, 2.0))),), "enclose an area"),
        ((Disc((0.0, 0.0), 0.0),), "positive radius"),
        ((Disc((math.inf, 0.0), 1.0),), "finite centre"),
        ((Disc((0.0, 0.0), math.nan),), "positive radius"),
        ((), "'nothing' has no shapes"),
    ],
)
def test_what_has_no_inside_is_refused(shapes, reason):
    with pytest.raises(PhantomError, match=reason):
        Phantom("nothing", shapes)


LOG_FIELD = 300.0


def image_at(log, height, size=300):
    return log.slice_at(height).rasterise(size, LOG_FIELD, subsamples=2)


def test_equal_seeds_give_equal_logs_and_other_seeds_others():
    assert LogModel.random(1001) == LogModel.random(1001)
    assert LogModel.random(1001) != LogModel.random(1002)
    assert LogModel.random(1001).slice_at(123.0) == LogModel.random(1001).slice_at(123.0)


@pytest.mark.parametrize("seed", range(1003, 1008))
def test_a_slice_is_wood_inside_the_bark_and_nothing_outside(seed):
    log = LogModel.random(seed)
    axis = (np.arange(300) + 0.5) - 150.0
    radius = np.hypot(axis[:, None], axis[None, :])
    for height in (10.0, 60.0, 130.0, 310.0):
        image = image_at(log, height)
        assert not image[radius > log.radius_mm + 1.5].any()
        wood = image[radius < log.radius_mm - 1.5]
        assert wood.min() > 0.5 * HEARTWOOD_PER_MM
        assert HEARTWOOD_PER_MM < wood.mean() < SAPWOOD_PER_MM * 1.2


def test_a_whorl_has_knots_clear_wood_has_none_and_metal_is_only_where_it_was_put():
    log = LogModel.random(1008)
    knots = {h: [s for s in log.slice_at(h).shapes if isinstance(s, Polygon)] for h in (60.0, 5.0)}
    assert len(knots[60.0]) >= 2
    assert not knots[5.0]
    log = LogModel.random(1009)
    inside, away = image_at(log, log.metal_height_mm), image_at(log, log.metal_height_mm + 60.0)
    i, j = (math.floor(c + LOG_FIELD / 2) for c in log.metal_mm)
    assert inside[i, j] > METAL_PER_MM
    assert away.max() < 0.2 * METAL_PER_MM


def test_a_slice_stays_within_its_log():
    for seed in range(1010, 1020):
        log = LogModel.random(seed)
        assert log.slice_at(60.0).radius_mm < 1.2 * log.radius_mm
