"""The filter, and blocks: slices and views a quarter turn apart are one algorithm with the slice by itself."""

import numpy as np
import pytest

from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, GeometryError
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.fbp import RowFilter, fbp, ramp_response
from sawmill_vocabulary import FilterName

# Positions on the detector are in single precision, 1e-4 of a cell, and views are summed in another order.
ROUNDING = 1e-4


@pytest.fixture
def projector(scanner, theta):
    def of(angles, size=65):
        return Projector(FanBeamGeometry(scanner, theta, angles), ImageGrid(size, 400.0))

    return of


def noise(views, slices, seed):
    return np.random.default_rng(seed).standard_normal((views, slices, 768)).astype(np.float32)


@pytest.mark.parametrize("slices", [1, 3, 5, 16, 33])
def test_a_block_is_its_slices(projector, irregular_turn, slices):
    # 38 views: no multiple of the views that are summed at a time. 65 pixels: no multiple of a tile.
    at = projector(irregular_turn(38, 701))
    stack = noise(38, slices, 702)
    volume = fbp(at, stack.transpose(1, 0, 2)).image
    assert volume.shape == (slices, 65, 65)
    for n in {0, slices // 2, slices - 1}:
        np.testing.assert_allclose(volume[n], fbp(at, stack[:, n]).image, atol=ROUNDING * np.abs(volume[n]).max())


@pytest.mark.parametrize("weighting", ["exact", "none"])
@pytest.mark.parametrize("sense", [1, -1])
def test_views_a_quarter_turn_apart_are_views_like_any_other(projector, full_turn, weighting, sense):
    angles, order = sense * full_turn(40), np.random.default_rng(703).permutation(40)
    stack = noise(40, 5, 704)
    options = {"filter_name": FilterName.COSINE, "frequency_scaling": 0.8, "weighting": weighting}
    shared = fbp(projector(angles, 64), stack[:, 0], **options).image
    for other in (
        fbp(projector(angles[order] + TAU, 64), stack[order, 0], **options).image,
        fbp(projector(angles, 64), stack.transpose(1, 0, 2), **options).image[0],
    ):
        np.testing.assert_allclose(shared, other, atol=ROUNDING * np.abs(shared).max())


def test_a_block_of_another_shape_is_refused(projector, full_turn):
    with pytest.raises(GeometryError, match=r"the block has shape \(5, 11, 768\).*\(any, 10, 768\)"):
        fbp(projector(full_turn(10)), noise(11, 5, 705).transpose(1, 0, 2))


PITCH = 1.5
every_filter = pytest.mark.parametrize("name", list(FilterName))
# At the cut-off, at half of it, by their definitions.
WINDOWS = {
    FilterName.RAM_LAK: (1.0, 1.0),
    FilterName.SHEPP_LOGAN: (2.0 / np.pi, 2.0 * np.sqrt(2.0) / np.pi),
    FilterName.COSINE: (0.0, np.sqrt(0.5)),
    FilterName.HAMMING: (0.08, 0.54),
    FilterName.HANN: (0.0, 0.5),
}


@every_filter
@pytest.mark.parametrize("scaling", [1.0, 0.5])
def test_the_window_is_what_its_name_means(name, scaling):
    # 256 cells pad to 512: the cut-off and its half fall on frequencies of the transform.
    response, length = ramp_response(256, PITCH, name, scaling)
    ramp, _ = ramp_response(256, PITCH, FilterName.RAM_LAK, 1.0)
    assert length == 512
    cut = round(256 * scaling)
    expected_at_cut, expected_at_half = WINDOWS[name]
    assert response[cut] / ramp[cut] == pytest.approx(expected_at_cut, abs=1e-12)
    assert response[cut // 2] / ramp[cut // 2] == pytest.approx(expected_at_half, abs=1e-12)
    np.testing.assert_array_equal(response[cut + 1 :], 0.0)


def test_the_ramp_is_the_frequency_in_cycles_per_mm():
    response, length = ramp_response(512, PITCH, FilterName.RAM_LAK, 1.0)
    frequency = np.arange(response.size) / (length * PITCH)
    # The kernel is cut off after 512 cells: its transform differs from |f| by 1 / (2 pi^2 n pitch) at most, 1e-4.
    np.testing.assert_allclose(response, frequency, atol=1.0 / (np.pi**2 * 512 * PITCH))
    # The mean of an image hangs on this: the response at 0 is small, but not 0.
    assert 0.0 < response[0] < 1e-3


def filtered(row, pitch, name):
    return RowFilter.of(np.ones(row.shape[-1]), pitch, name, 1.0)(row)


def test_the_kernel_is_that_of_kak_and_slaney():
    row = np.zeros((1, 65), np.float32)
    row[0, 32] = 1.0
    kernel = filtered(row, PITCH, FilterName.RAM_LAK)[0]
    n = np.arange(65) - 32
    # Eq. 3.61 times the cell's width; single precision relative to the peak.
    expected = np.where(n % 2 == 1, -1.0 / (np.pi * np.where(n == 0, 1, n) * PITCH) ** 2, 0.0) * PITCH
    expected[32] = 0.25 / PITCH
    np.testing.assert_allclose(kernel, expected, atol=1e-6 * expected[32])


@every_filter
def test_filtering_is_the_convolution_with_zeros_outside(name):
    """No value wraps round from one end of the detector to the other."""
    row = np.random.default_rng(401).standard_normal((2, 40)).astype(np.float32)
    wide = np.zeros((2, 400), np.float32)
    wide[:, :40] = row
    short = filtered(row, PITCH, name)
    long = filtered(wide, PITCH, name)[:, :40]
    # A window's own tail is cut by the padding: a thousandth of the peak.
    np.testing.assert_allclose(short, long, atol=2e-3 * np.abs(long).max())


@every_filter
def test_a_smooth_row_is_filtered_alike_by_every_window(name):
    x = np.arange(301) - 150.0
    row = np.exp(-0.5 * (x / 30.0) ** 2)[None].astype(np.float32)
    smooth = filtered(row, 1.0, name)[0]
    ramp = filtered(row, 1.0, FilterName.RAM_LAK)[0]
    # The row's frequencies end near 1 / 60 of the cut-off, where every window is 1 to a hundredth.
    np.testing.assert_allclose(smooth, ramp, atol=0.01 * np.abs(ramp).max())


@pytest.mark.parametrize("scaling", [0.0, -0.5, 1.01, float("nan")])
def test_a_cut_off_outside_the_detector_s_frequencies_is_refused(scaling):
    with pytest.raises(GeometryError, match="frequency_scaling must be above 0 and at most 1"):
        ramp_response(64, PITCH, FilterName.HANN, scaling)


def test_the_weight_comes_before_the_ramp():
    rng = np.random.default_rng(402)
    rows, weight = rng.standard_normal((3, 33)).astype(np.float32), rng.uniform(0.5, 1.0, 33)
    both = RowFilter.of(weight, PITCH, FilterName.HANN, 1.0)(rows)
    expected = filtered((rows * weight).astype(np.float32), PITCH, FilterName.HANN)
    np.testing.assert_allclose(both, expected, atol=1e-6 * np.abs(expected).max())
