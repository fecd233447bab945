import math
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image

from sawmill_tomography.phantoms.built_in import L_SHAPE, RECTANGLE_WITH_HOLE
from sawmill_tomography.phantoms.phantom import Disc, Phantom, PhantomError, Polygon
from sawmill_tomography.phantoms.tracing import trace
from sawmill_vocabulary import STANDARD_SIZE_TOLERANCE, fault_of_outline

FIELD = 400.0
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
    """Points of a closed outline, `step_mm` apart or less."""
    pieces = []
    for a, b in pairwise(line):
        count = max(2, math.ceil(math.dist(a, b) / step_mm))
        pieces.append(a + np.linspace(0.0, 1.0, count, endpoint=False)[:, None] * (b - a))
    return np.concatenate(pieces)


def distance_to(line, points):
    """Of each point to the nearest segment of a closed outline."""
    a, side = line[:-1], np.diff(line, axis=0)
    share = ((points[:, None] - a) * side).sum(-1) / (side**2).sum(-1)
    feet = a + share.clip(0.0, 1.0)[..., None] * side
    return np.linalg.norm(points[:, None] - feet, axis=-1).min(axis=1)


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
