"""Where pixels lie, and images of a region of interest: the same pixels as in an image of the whole."""

import numpy as np
import pytest

from sawmill_tomography.geometry.geometry import FanBeamGeometry, GeometryError
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.fbp import fbp

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
