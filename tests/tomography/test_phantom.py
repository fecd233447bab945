"""Phantoms, and random logs."""

import math
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image

from sawmill_tomography.phantoms.built_in import BUILT_IN, L_SHAPE, RECTANGLE_WITH_HOLE
from sawmill_tomography.phantoms.log_model import HEARTWOOD_PER_MM, METAL_PER_MM, SAPWOOD_PER_MM, LogModel
from sawmill_tomography.phantoms.phantom import Disc, Phantom, PhantomError, Polygon
from sawmill_tomography.phantoms.tracing import trace
from sawmill_vocabulary import STANDARD_SIZE_TOLERANCE, fault_of_outline

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
    bark = Phantom("bark", (Polygon(log.outline(1.0)),))
    larger, smaller = (bark.scaled(factor).rasterise(300, LOG_FIELD) for factor in (1.012, 0.988))
    for height in (10.0, 60.0, 130.0, 310.0):
        image = image_at(log, height)
        assert not image[larger == 0.0].any()
        wood = image[smaller == 1.0]
        assert wood.min() > 0.5 * HEARTWOOD_PER_MM
        assert HEARTWOOD_PER_MM < wood.mean() < SAPWOOD_PER_MM * 1.2


def test_a_whorl_has_knots_clear_wood_has_none_and_metal_is_only_where_it_was_put():
    log = LogModel.random(1008)
    clear, knots = (log.slice_at(height).shapes for height in (5.0, 60.0))
    assert len(clear) == 2 + len(log.rings)
    assert clear == knots[: len(clear)]
    assert len(knots) >= len(clear) + 2
    log = LogModel.random(1009)
    inside, away = image_at(log, log.metal_height_mm), image_at(log, log.metal_height_mm + 60.0)
    i, j = (math.floor(c + LOG_FIELD / 2) for c in log.metal_mm)
    assert inside[i, j] > METAL_PER_MM
    assert away.max() < 0.2 * METAL_PER_MM


def test_the_outlines_of_logs_vary_as_those_of_two_trees_do():
    spectra = []
    for seed in range(400):
        log = LogModel.random(seed)
        bark, middle = (
            np.hypot(*(log.outline(share) - (1.0 - share) * np.array(log.pith_mm)).T) for share in (1, 0.75)
        )
        spectra.append([2.0 * np.fft.rfft(radii)[1:8] / radii.sum() for radii in (bark, middle)])
    bark, middle = np.swapaxes(spectra, 0, 1)
    spread = np.sqrt(0.5 * np.mean(np.abs(bark) ** 2, axis=0))
    assert spread == pytest.approx([0.0, 0.0145, 0.017, 0.014, 0.0078, 0.0078, 0.0], rel=0.1, abs=1e-4)
    assert np.linalg.norm(spread) == pytest.approx(0.029, abs=0.003)
    assert np.corrcoef(bark[:, 1:6].real.ravel(), middle[:, 1:6].real.ravel())[0, 1] == pytest.approx(0.74, abs=0.05)


@pytest.mark.parametrize("seed", range(1020, 1030))
def test_no_ring_crosses_the_next_one(seed):
    log = LogModel.random(seed)
    x, y = (np.array([log.outline(share) for share, _ in log.rings]) - log.pith_mm).transpose(2, 0, 1)
    radii = [
        np.interp(np.arange(360.0), np.degrees(np.arctan2(*one)), np.hypot(*one), period=360.0)
        for one in zip(y, x, strict=True)
    ]
    assert (np.diff(radii, axis=0) < 0.0).all()


def test_a_slice_stays_within_its_log():
    for seed in range(1010, 1020):
        log = LogModel.random(seed)
        assert log.slice_at(60.0).radius_mm < 1.2 * log.radius_mm


DISC = Phantom("disc", (Disc((13.0, -21.0), 70.0),))
TWO_BODIES = Phantom(
    "two bodies", (Disc((-91.3, 40.7), 54.6), Polygon(((20.0, -120.0), (130.0, -90.0), (80.0, 60.0), (10.0, 10.0))))
)
UPRIGHT = {"l": L_SHAPE, "rectangle with hole": RECTANGLE_WITH_HOLE}
OBLIQUE = {
    "l turned": L_SHAPE.rotated(0.3),
    "l turned and moved": L_SHAPE.rotated(1.2).moved(7.0, -3.0),
    "rectangle turned": RECTANGLE_WITH_HOLE.rotated(0.5),
    "disc": DISC,
    "two bodies": TWO_BODIES,
}


def along(line, step_mm):
    pieces = []
    for a, b in pairwise(line):
        count = max(2, math.ceil(math.dist(a, b) / step_mm))
        pieces.append(a + np.linspace(0.0, 1.0, count, endpoint=False)[:, None] * (b - a))
    return np.concatenate(pieces)


def distance_to(line, points):
    a, side = line[:-1], np.diff(line, axis=0)
    share = ((points[:, None] - a) * side).sum(-1) / (side**2).sum(-1)
    return np.linalg.norm(points[:, None] - (a + share.clip(0.0, 1.0)[..., None] * side), axis=-1).min(axis=1)


def misplacement_px(traced, drawn, size):
    """Distances between the outlines of two phantoms, both ways, in pixels of a picture of the field."""
    assert sorted(type(s).__name__ for s in traced.shapes) == sorted(type(s).__name__ for s in drawn.shapes)
    distances = []
    for one, other in ((traced, drawn), (drawn, traced)):
        targets = other.outlines(points_per_disc=361)
        for line in one.outlines(points_per_disc=361):
            points = along(line, 4.0)
            distances.append(np.min([distance_to(target, points) for target in targets], axis=0))
    return np.concatenate(distances) * size / FIELD


@pytest.mark.parametrize("size", [200, 401])
@pytest.mark.parametrize("name", UPRIGHT | OBLIQUE)
def test_a_drawing_is_traced_to_a_tenth_of_a_pixel_and_a_black_and_white_one_to_half_a_pixel(name, size):
    drawn = (UPRIGHT | OBLIQUE)[name]
    traced = trace(drawn.rasterise(size, FIELD, subsamples=8), FIELD, name=name)
    outlines = [shape.vertices_mm for shape in traced.shapes if isinstance(shape, Polygon)]
    assert [fault_of_outline(corners) for corners in outlines] == [None] * len(outlines)
    off = misplacement_px(traced, drawn, size)
    assert np.sqrt(np.mean(off**2)) < 0.1
    # A grey pixel of coverage c puts the half-way level off by (c - 1/2) (1/c - 1), 0.086 pixels at worst, and eight
    # sub-samples round c by 1/16; a corner misses by both its sides.
    assert off.max() < math.sqrt(2.0) * (0.086 + 1.0 / 16.0)
    off = misplacement_px(trace(drawn.rasterise(size, FIELD, subsamples=1), FIELD, name=name), drawn, size)
    # In black and white, half a pixel is all that a picture along the pixels holds: a side lies anywhere between two
    # pixel centres. Oblique sides' steps average out.
    assert off.max() < (0.5 if name in OBLIQUE else 0.5 * math.sqrt(2.0) + 0.01)
    assert name in UPRIGHT or np.sqrt(np.mean(off**2)) < 0.1


def test_rows_are_x_and_columns_are_y_and_the_centre_is_the_origin():
    picture = np.zeros((60, 100))
    # Rows 10..19 and columns 70..89 of pixels 2 mm wide.
    picture[10:20, 70:90] = 255.0
    (body,) = trace(picture, 200.0, name="bar").shapes
    x, y = np.array(body.vertices_mm).T
    # Contours round the very corners; the sides are straight, so their meetings are exact to a hundredth of a pixel.
    np.testing.assert_allclose([x.min(), x.max(), y.min(), y.max()], [-40.0, -20.0, 40.0, 80.0], atol=0.02)


def test_a_hole_subtracts_and_a_body_in_the_hole_adds():
    rings = Phantom("rings", (Disc((0.0, 0.0), 150.0), Disc((10.0, 0.0), 80.0, -1.0), Disc((10.0, 5.0), 30.0)))
    traced = trace(rings.rasterise(300, FIELD), FIELD, name="rings")
    by_radius = sorted(traced.shapes, key=lambda disc: -disc.radius_mm)
    assert [disc.density for disc in by_radius] == [1.0, -1.0, 1.0]
    np.testing.assert_allclose(traced.rasterise(300, FIELD), rings.rasterise(300, FIELD), atol=0.5)


def test_a_body_that_reaches_the_border_is_closed_there():
    picture = np.zeros((50, 50))
    picture[:20, 10:40] = 1.0
    (body,) = trace(picture, 50.0, name="half").shapes
    assert len(body.vertices_mm) == 4
    assert min(x for x, _ in body.vertices_mm) == pytest.approx(-25.0, abs=0.1)


def test_a_traced_size_is_as_uncertain_as_its_pixels_and_specks_are_left_out():
    coarse, fine = (trace(L_SHAPE.rasterise(size, 400.0, subsamples=1), 400.0, name="l") for size in (160, 1600))
    # 2.5 mm over sqrt(6), of an L of 200 by 301 mm.
    assert coarse.size_tolerance == pytest.approx(2.5 / math.sqrt(6.0) / 250.5, rel=0.02)
    assert fine.size_tolerance == STANDARD_SIZE_TOLERANCE
    picture = DISC.rasterise(200, FIELD)
    picture[5, 5] = picture[180, 20] = 1.0
    assert len(trace(picture, FIELD, name="dusty").shapes) == 1


def test_the_published_drawing_is_the_built_in_l(published_data):
    picture = np.asarray(Image.open(published_data / "l-phantom" / "reference.png").convert("L"), np.float64)
    (traced,) = trace(picture, FIELD, name="reference").shapes
    corners = np.array(traced.vertices_mm)
    assert len(corners) == 6
    for corner in L_SHAPE.shapes[0].vertices_mm:
        assert np.linalg.norm(corners - corner, axis=1).min() < 0.05


@pytest.mark.parametrize(
    ("picture", "width", "says"),
    [
        (np.zeros((4, 100)), FIELD, r"shape \(4, 100\)"),
        (np.zeros((20, 20, 3)), FIELD, r"shape \(20, 20, 3\)"),
        (np.eye(20), 0.0, "width is 0 mm: give the width of the whole picture, at least 0.1 mm"),
        (np.eye(20), math.nan, "width is nan mm"),
        (np.full((20, 20), 7.0), FIELD, "of one grey throughout"),
        (np.pad(np.ones((2, 2)), 20), FIELD, "no outline of at least 25 pixels"),
        (np.kron(np.indices((42, 42)).sum(0) % 2, np.ones((8, 8))), FIELD, "outlines, more than 200"),
    ],
    ids=["too small", "colours", "no width", "width nan", "empty", "speck", "chequered"],
)
def test_a_picture_of_no_phantom_is_refused(picture, width, says):
    with pytest.raises(PhantomError, match=says):
        trace(picture, width, name="picture")
