"""Where pixels lie, and images of a region of interest: the same pixels as in an image of the whole."""

import math

import astra
import numpy as np
import pytest

from sawmill_tomography.geometry.geometry import FanBeamGeometry, FanViews, GeometryError, Scanner, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.phantom import Disc, Phantom, Polygon
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.fbp import fbp

STRAIGHT = Theta(0.4, 700.0, 0.0, 0.0, 0.0)
SHIFTED = Theta(5.9, 650.0, -280.0, 120.0, 0.0)
TILTED = Theta(1.1, 720.0, 150.0, -90.0, -0.6)
GEOMETRIES = {"straight": STRAIGHT, "shifted": SHIFTED, "tilted": TILTED, "each view its own": TILTED}

every_geometry = pytest.mark.parametrize("name", GEOMETRIES)
every_turn = pytest.mark.parametrize("name", list(GEOMETRIES)[:3])
every_size = pytest.mark.parametrize("size", [16, 33, 128])


@pytest.fixture
def projector(irregular_turn):
    """A projector of the named geometry; an odd image has an odd detector."""

    def make(name, size, *, views=17, field_mm=400.0):
        cells = 96 + size % 2
        geometry = FanBeamGeometry(Scanner(860.0, cells, 1100.0 / cells), GEOMETRIES[name], irregular_turn(views, 301))
        return Projector(scattered(geometry) if name == "each view its own" else geometry, ImageGrid(size, field_mm))

    return make


def scattered(geometry):
    """The geometry with sources, detectors and axes that depart from the turn, and cells counted from another point."""
    source, middle, axis = (
        each + np.random.default_rng(300).uniform(-reach, reach, each.shape)
        for each, reach in zip(geometry.vectors(), (30.0, 20.0, 0.1), strict=True)
    )
    return FanViews.of(source, middle, axis, geometry.borders_mm + 7.0)


def smooth_image(size, seed):
    """Random, of a few waves, with no symmetry."""
    rng = np.random.default_rng(seed)
    x = (np.arange(size) + 0.5) / size
    image = np.zeros((size, size))
    for _ in range(8):
        kx, ky, phase = rng.uniform(-3.0, 3.0), rng.uniform(-3.0, 3.0), rng.uniform(0.0, 2.0 * math.pi)
        image += np.sin(2.0 * math.pi * (kx * x[:, None] + ky * x[None, :]) + phase)
    return image.astype(np.float32)


@every_geometry
@every_size
def test_forward_and_adjoint_pass_the_dot_test(projector, name, size):
    rng = np.random.default_rng(302)
    a = projector(name, size)
    image = rng.standard_normal((size, size)).astype(np.float32)
    sinogram = rng.standard_normal(a.geometry.sinogram_shape).astype(np.float32)
    projected, back = a.forward(image).astype(np.float64), a.adjoint(sinogram).astype(np.float64)
    mismatch = np.vdot(projected, sinogram) - np.vdot(image, back)
    # Both are stored in single precision (6e-8 a term).
    assert abs(mismatch) < 1e-6 * np.linalg.norm(projected) * np.linalg.norm(sinogram)


@every_geometry
@pytest.mark.parametrize("slices", [1, 3, 16, 17])
def test_a_block_is_its_slices_one_by_one(projector, name, slices):
    rng = np.random.default_rng(306)
    a = projector(name, 33)
    images = rng.standard_normal((slices, 33, 33)).astype(np.float32)
    sinograms = rng.standard_normal((slices, *a.geometry.sinogram_shape)).astype(np.float32)
    forward, back = a.forward(images), a.adjoint(sinograms)
    # The slices share their lengths; only the order of summation differs, over at most 33 slabs or a few hundred rays.
    for index in range(slices):
        alone = a.forward(images[index])
        assert np.linalg.norm(forward[index] - alone) < 1e-6 * np.linalg.norm(alone)
        alone = a.adjoint(sinograms[index])
        assert np.linalg.norm(back[index] - alone) < 1e-6 * np.linalg.norm(alone)


@every_turn
@pytest.mark.parametrize("sense", [1, -1])
# One, four and sixteen lanes hold them; more than eight slices are not turned.
@pytest.mark.parametrize("slices", [1, 3, 5, 9])
def test_views_a_quarter_turn_apart_are_views_like_any_other(projector, full_turn, name, sense, slices):
    rng = np.random.default_rng(307)
    angles, order = sense * full_turn(12), rng.permutation(12)
    geometry, grid = projector(name, 33).geometry, ImageGrid(33, 400.0)
    shared, any_order = (Projector(geometry.with_angles(chosen), grid) for chosen in (angles, angles[order]))
    assert (shared.quarter_turn, any_order.quarter_turn) == (sense, 0)
    images = rng.standard_normal((slices, 33, 33)).astype(np.float32)
    sinograms = rng.standard_normal((slices, *shared.geometry.sinogram_shape)).astype(np.float32)
    forward, back = shared.forward(images), shared.adjoint(sinograms)
    # The turned views' angles are exact to 1e-15; the order of summation differs.
    others = any_order.forward(images)
    assert np.linalg.norm(forward[:, order] - others) < 1e-6 * np.linalg.norm(others)
    others = any_order.adjoint(sinograms[:, order])
    assert np.linalg.norm(back - others) < 1e-6 * np.linalg.norm(others)


def test_quarter_turns_need_the_centre_of_rotation_in_the_middle_and_views_that_repeat(projector, full_turn):
    geometry = projector("straight", 16).geometry

    def of(angles, centre_mm=(0.0, 0.0)):
        return Projector(geometry.with_angles(angles), ImageGrid(16, 200.0, centre_mm)).quarter_turn

    assert of(full_turn(20)) == 1
    assert of(full_turn(20), (10.0, 0.0)) == 0
    assert of(full_turn(18)) == 0
    # A view that is off by more than the edge of a log could show.
    angles = full_turn(20)
    angles[7] += 1e-5
    assert of(angles) == 0


@every_geometry
@every_size
def test_forward_and_adjoint_agree_with_astra(projector, name, size):
    a = projector(name, size)
    half = 0.5 * a.grid.field_mm
    volume = astra.create_vol_geom(size, size, -half, half, -half, half)
    rays = astra.create_proj_geom("fanflat_vec", a.geometry.sinogram_shape[1], a.geometry.astra_vectors())
    identifier = astra.create_projector("line_fanflat", rays, volume)
    oracle, image = astra.OpTomo(identifier), smooth_image(size, 303)
    ours, theirs = a.forward(image), oracle.FP(image)
    # ASTRA is in single precision throughout: at 128 pixels it is 1e-5 from the matrix of exact lengths, we 3e-8.
    assert np.linalg.norm(ours - theirs) < 1e-4 * np.linalg.norm(theirs)
    sinogram = np.random.default_rng(304).standard_normal(a.geometry.sinogram_shape).astype(np.float32)
    ours, theirs = a.adjoint(sinogram), oracle.BP(sinogram)
    astra.projector.delete(identifier)
    # Its adjoint is 5e-4 from the matrix's transpose at 128 pixels, ours 6e-8.
    assert np.linalg.norm(ours - theirs) < 1e-3 * np.linalg.norm(theirs)


def lengths_by_clipping(projector):
    """The dense matrix (rays, pixels) from clipping each ray to each pixel's square, in double precision."""
    geometry, grid = projector.geometry, projector.grid
    source, centre, axis = geometry.vectors()
    ends = centre[:, None, :] + geometry.borders_mm.mean(axis=1)[None, :, None] * axis[:, None, :]
    along = ends - source[:, None, :]
    along = (along / np.linalg.norm(along, axis=-1, keepdims=True)).reshape(-1, 1, 2)
    start = np.repeat(source, geometry.sinogram_shape[1], axis=0)[:, None, :]
    middle = np.stack(np.meshgrid(grid.x_mm, grid.y_mm, indexing="ij"), -1).reshape(1, -1, 2)
    one = (middle - 0.5 * grid.pixel_mm - start) / along
    other = (middle + 0.5 * grid.pixel_mm - start) / along
    return np.maximum(np.maximum(one, other).min(-1) - np.minimum(one, other).max(-1), 0.0)


@every_geometry
def test_the_operator_is_the_dense_matrix_of_intersection_lengths(projector, name):
    a = projector(name, 16)
    columns = []
    for pixel in range(256):
        unit = np.zeros(256, np.float32)
        unit[pixel] = 1.0
        columns.append(a.forward(unit.reshape(16, 16)).ravel())
    built = np.stack(columns, -1)
    dense = lengths_by_clipping(a)
    # A pixel is 25 mm wide; lengths are stored in single precision.
    np.testing.assert_allclose(built, dense, atol=25.0 * 4e-6)
    sinogram = np.random.default_rng(305).standard_normal(a.geometry.sinogram_shape)
    back = (dense.T @ sinogram.ravel()).reshape(16, 16)
    assert np.linalg.norm(a.adjoint(sinogram) - back) < 1e-6 * np.linalg.norm(back)


@every_turn
def test_a_rectangle_of_whole_pixels_is_projected_as_the_polygon_it_is(projector, name):
    a = projector(name, 32, field_mm=320.0)
    image = np.zeros((32, 32), np.float32)
    image[5:20, 9:25] = 1.5
    body = Phantom("rectangle", (Polygon(((-110.0, -70.0), (40.0, -70.0), (40.0, 90.0), (-110.0, 90.0)), 1.5),))
    geometry = a.geometry
    seen = analytic.project(
        body, DetectorCells.of(geometry.scanner), geometry.frame, geometry.angles_rad, rays_per_cell=1
    )
    # Sums of up to 32 slabs in single precision, of at most 330 mm.
    np.testing.assert_allclose(a.forward(image), seen, atol=330.0 * 1e-5)


def test_a_ray_along_a_row_of_pixels_has_the_row_s_length():
    """A ray with slope exactly 0, where a march over pixels divides by nothing."""
    geometry = FanBeamGeometry(Scanner(500.0, 3, 1.0), Theta(0.0, 300.0, 0.0, 0.0, 0.0), np.array([0.0, math.pi]))
    a = Projector(geometry, ImageGrid(5, 50.0))
    image = np.arange(25, dtype=np.float32).reshape(5, 5)
    np.testing.assert_allclose(a.forward(image)[:, 1], 10.0 * image[2].sum(), rtol=1e-6)


def test_what_does_not_fit_and_a_grid_without_pixels_are_refused(projector):
    a = projector("straight", 16)
    with pytest.raises(GeometryError, match=r"the image has shape \(15, 16\); this grid is 16 x 16"):
        a.forward(np.zeros((15, 16)))
    with pytest.raises(GeometryError, match=r"the sinogram has shape \(17, 95\)"):
        a.adjoint(np.zeros((17, 95)))
    with pytest.raises(GeometryError, match=r"the sinogram has shape \(0, 17, 96\)"):
        a.block(np.zeros((0, 17, 96)))
    with pytest.raises(GeometryError, match="past the source"):
        Projector(a.geometry, ImageGrid(16, 1300.0))
    without = (0, 400.0, "at least one pixel"), (16, 0.0, "positive number of millimetres"), (16, math.nan, "positive")
    for size, field, words in without:
        with pytest.raises(GeometryError, match=words):
            ImageGrid(size, field)


def test_a_field_that_no_ray_crosses_is_refused_in_a_sentence():
    """As with a detector shift of a metre given by mistake: every method asks, before it divides by nothing."""
    beside = Theta(0.0, 700.0, 0.0, 1500.0, 0.0)
    geometry = FanBeamGeometry(Scanner(859.46, 64, 5.0), beside, np.arange(12) * np.pi / 6.0)
    projector = Projector(geometry, ImageGrid(16, 200.0))
    with pytest.raises(GeometryError, match="no measured ray crosses the field"):
        _ = projector.crossing


WHOLE = ImageGrid(128, 320.0)
# Pixels 70..101 along x and 20..51 along y of the whole.
PART = slice(70, 102), slice(20, 52)
REGION = ImageGrid(32, 80.0, (2.5 * 22.0, 2.5 * -28.0))
KNOTS = Phantom("knots", (Disc((0.0, 0.0), 120.0, 0.4), Disc((50.0, -66.0), 14.0, 0.3), Disc((-40.0, 30.0), 20.0, 0.2)))


@pytest.fixture
def geometry(scanner, theta, irregular_turn):
    return FanBeamGeometry(scanner, theta, irregular_turn(60, 811))


def test_pixels_stand_around_the_centre_of_their_field():
    grid = ImageGrid(4, 8.0, (10.0, -3.0))
    np.testing.assert_allclose(grid.x_mm, [7.0, 9.0, 11.0, 13.0], atol=1e-14)
    np.testing.assert_allclose(grid.y_mm, [-6.0, -4.0, -2.0, 0.0], atol=1e-14)
    assert grid.reach_mm == pytest.approx(np.hypot(14.0, 7.0))
    np.testing.assert_allclose(ImageGrid(3, 9.0).x_mm, [-3.0, 0.0, 3.0], atol=1e-15)


@pytest.mark.parametrize("views", ["any", "quarter turns"])
@pytest.mark.parametrize("weighting", ["exact", "none"])
def test_back_projection_of_a_region_is_cut_out_of_the_whole(scanner, theta, geometry, full_turn, views, weighting):
    if views == "quarter turns":
        geometry = FanBeamGeometry(scanner, theta, full_turn(60))
    sinogram = analytic.project(KNOTS, DetectorCells.of(scanner), geometry.frame, geometry.angles_rad)
    whole = fbp(Projector(geometry, WHOLE), sinogram, weighting=weighting).image[PART]
    region = Projector(geometry, REGION)
    # Positions on the detector are single precision: a ten-thousandth of a cell.
    np.testing.assert_allclose(fbp(region, sinogram, weighting=weighting).image, whole, atol=1e-4 * whole.max())
    block = fbp(region, np.stack([sinogram] * 5), weighting=weighting).image
    np.testing.assert_allclose(block, np.stack([whole] * 5), atol=1e-4 * whole.max())


def test_rays_through_a_region_are_those_through_the_whole_and_its_adjoint_is_its_transpose(geometry):
    image = np.zeros((128, 128), np.float32)
    image[PART] = np.random.default_rng(812).random((32, 32), dtype=np.float32)
    expected = Projector(geometry, WHOLE).forward(image)
    # Sums in single precision.
    np.testing.assert_allclose(Projector(geometry, REGION).forward(image[PART]), expected, atol=2e-4 * expected.max())
    rng = np.random.default_rng(813)
    a = Projector(geometry, REGION)
    x, y = rng.standard_normal((32, 32)), rng.standard_normal(geometry.sinogram_shape)
    left, right = np.vdot(a.forward(x).astype(float), y), np.vdot(x, a.adjoint(y).astype(float))
    # Images and sinograms are single precision.
    assert left == pytest.approx(right, abs=1e-5 * np.linalg.norm(a.forward(x)) * np.linalg.norm(y))


@pytest.mark.parametrize("grid", [REGION, ImageGrid(17, 50.0, (-300.0, 3.0)), WHOLE, ImageGrid(3, 9.0, (0.3, 0.1))])
def test_the_grid_around_a_region_holds_the_object_and_the_same_pixels(grid):
    larger, (x, y) = grid.around(135.0)
    np.testing.assert_allclose(larger.x_mm[x], grid.x_mm, atol=1e-9)
    np.testing.assert_allclose(larger.y_mm[y], grid.y_mm, atol=1e-9)
    half = 0.5 * larger.pixel_mm
    for axis in (larger.x_mm, larger.y_mm):
        assert axis[0] - half <= -135.0 + 1e-9
        assert axis[-1] + half >= 135.0 - 1e-9


def test_a_grid_that_holds_the_object_is_its_own_surrounding_and_one_at_the_source_is_refused(geometry):
    assert WHOLE.around(160.0) == (WHOLE, (slice(0, 128), slice(0, 128)))
    Projector(geometry, ImageGrid(16, 100.0, (500.0, 0.0)))
    with pytest.raises(GeometryError, match=r"past the source at .*, or one nearer to the rotation centre$"):
        Projector(geometry, ImageGrid(16, 100.0, (0.0, -900.0)))
    with pytest.raises(GeometryError, match="centre_mm must be two finite numbers"):
        ImageGrid(16, 100.0, (np.nan, 0.0))
