"""A region of interest over a knot: its pixels are those of the whole image."""

import numpy as np
import pytest
from small_scanner import reconstruction_input

from sawmill_calibration.checkpoints import Keeper
from sawmill_calibration.reconstruction.reconstruct import reconstruct_in_memory, run_reconstruction
from sawmill_contracts.reconstructions import ReconstructionOptions
from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, GeometryError, Scanner, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.projection.simulate import simulate_rows
from sawmill_tomography.reconstruction.iterative.coarse_outside import TwoGrids
from sawmill_tomography.reconstruction.quality import relative_error

MILL = Scanner(source_to_cor_mm=859.46, num_detector_pixels=384, detector_pitch_mm=1.5)
THETA = Theta(0.7, 715.0, 40.0, 10.0, 0.05)
SIZE, FIELD_MM, ROWS = 512, 400.0, 3
# Bark, rings, and knots inside and outside of the region.
BARK = [Disc((8.0, -5.0), 125.0, 0.022), Disc((8.0, -5.0), 118.0, -0.004)]
RINGS = [Disc((5.0, -3.0), 9.0 * ring, (-1) ** ring * 0.002) for ring in range(1, 13)]
KNOTS = [Disc((55.0, 30.0), 9.0, 0.008), Disc((-60.0, -35.0), 12.0, 0.008), Disc((-20.0, 70.0), 7.0, -0.006)]
LOG = Phantom("log", (*BARK, *RINGS, *KNOTS))
PART = slice(302, 350), slice(270, 318)
CENTRE_MM = (54.6875, 29.6875)
REGION = {"size": 48, "field_mm": 48 * FIELD_MM / SIZE, "field_centre_mm": CENTRE_MM}
WHOLE = {"size": SIZE, "field_mm": FIELD_MM}


@pytest.fixture(scope="module")
def truth():
    return LOG.moved(-CENTRE_MM[0], -CENTRE_MM[1]).rasterise(REGION["size"], REGION["field_mm"])


def scan(views=20, rows=1, noise=0.02):
    fan = FanBeamGeometry(MILL, THETA, (np.arange(views) + 0.5) * TAU / views)
    return reconstruction_input(simulate_rows([LOG] * rows, fan, noise=noise, seed=2706), fan)


def made(given, **options):
    asked = ReconstructionOptions(**{"method": "fbp", "metal": "none", **options})
    return reconstruct_in_memory(given, given.geometry, asked, lambda _: None)


def test_a_region_by_fbp_has_the_values_of_the_whole():
    given = scan(views=30)
    region, whole = made(given, **REGION), made(given, **WHOLE)
    # Positions on the detector are single precision.
    np.testing.assert_allclose(region.data, whole.data[:, *PART], atol=1e-4 * whole.data.max())
    assert region.result.method.data_misfit is None


@pytest.mark.parametrize("method", ["fbp", "tikhonov"])
def test_a_region_beyond_what_the_rays_see_is_refused(method):
    with pytest.raises(GeometryError, match=r"field_centre_mm 300, 0 begins 281.2 mm .* and the rays see 1\d\d"):
        made(scan(), method=method, **REGION | {"field_centre_mm": (300.0, 0.0)})


@pytest.mark.slow
def test_the_log_outside_of_a_region_is_held_at_larger_pixels(truth):
    found = made(scan(), method="tikhonov", **REGION)
    assert any("pixels of 1.56 mm" in remark for remark in found.result.method.remarks)
    # Explained by its own pixels alone, the region would have several times the wood's attenuation.
    assert relative_error(found.data[0], truth) < 0.3
    assert found.result.method.data_misfit < 1.3


def test_pixels_of_both_sizes_lie_side_by_side():
    field = ImageGrid(48, 37.5, CENTRE_MM)
    grids = TwoGrids.of(field, 140.0)
    np.testing.assert_allclose(grids.region.x_mm[grids.field[0]], field.x_mm, atol=1e-9)
    np.testing.assert_allclose(grids.region.y_mm[grids.field[1]], field.y_mm, atol=1e-9)
    factor = round(grids.whole.pixel_mm / field.pixel_mm)
    assert factor == 2
    large, own = grids.whole, grids.region
    for covered, pixels in ((large.x_mm[grids.inside[0]], own.x_mm), (large.y_mm[grids.inside[1]], own.y_mm)):
        np.testing.assert_allclose(covered, pixels.reshape(-1, factor).mean(axis=1), atol=1e-9)
    half = 0.5 * grids.whole.pixel_mm
    assert grids.whole.x_mm[0] - half < -140.0 < 140.0 < grids.whole.x_mm[-1] + half


@pytest.mark.parametrize(
    "field", [ImageGrid(256, 400.0), ImageGrid(48, 75.0, CENTRE_MM), ImageGrid(400, 250.0, (10.0, 0.0))]
)
def test_a_field_that_saves_little_has_pixels_of_one_size(field):
    """Of all of the log, of a coarse image, and of most of the log."""
    assert TwoGrids.of(field, 130.0) is None


# Nine logs and regions of `benchmarks/region.py` at 3ab7f653
# have at most 1.034 times the whole's error at 2 % noise.
@pytest.mark.nightly
@pytest.mark.parametrize("views", [20, 360])
@pytest.mark.parametrize("method", ["tikhonov", "cauchy_map", "total_variation"])
def test_a_region_has_the_error_of_the_whole_there(truth, method, views):
    if (method, views) == ("cauchy_map", 360):
        pytest.skip("no method for as many views: it takes minutes")
    given = scan(views)
    region, whole = (made(given, method=method, **field).data for field in (REGION, WHOLE))
    assert relative_error(region[0], truth) < 1.05 * relative_error(whole[0][PART], truth)


@pytest.mark.nightly
def test_coupled_rows_of_a_region_help_each_other(truth):
    given = scan(rows=ROWS, noise=0.04)
    errors = {
        coupling: relative_error(
            made(given, method="total_variation", coupling=coupling, **REGION).data, [truth] * ROWS
        )
        for coupling in ("0.5", "none")
    }
    assert errors["0.5"] < errors["none"]


@pytest.mark.nightly
def test_an_attempt_that_goes_on_takes_the_weight_that_was_chosen(tmp_path):
    class Kept(Keeper):
        has_begun = True
        settings = None

        def keep(self, name, arrays, _made_with=None):
            if name == "settings":
                self.settings = arrays

        def kept(self, name, _made_with=None):
            return self.settings if name == "settings" else None

    keeper, asked = Kept(), ReconstructionOptions(method="total_variation", coupling="none", **REGION)
    given = scan(rows=ROWS)
    chosen = run_reconstruction(given, given.geometry, asked, tmp_path / "one.h5", lambda _: None, keeper)
    again = run_reconstruction(given, given.geometry, asked, tmp_path / "two.h5", lambda _: None, keeper)
    assert keeper.settings is not None
    assert b"outside_weight" in bytes(keeper.settings["settings"])
    # Chosen again, the weight could differ in rounding only; it is the work that must not be done again.
    assert again.time_s < chosen.time_s
    assert again.method.weight == chosen.method.weight
