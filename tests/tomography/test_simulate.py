import math

import numpy as np
import pytest

from sawmill_tomography.geometry.geometry import FanBeamGeometry, GeometryError
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.preparing.line_integrals import line_integrals
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_tomography.projection.simulate import simulate_sinogram, simulate_stack


@pytest.fixture
def geometry(scanner, theta, full_turn):
    return FanBeamGeometry(scanner, theta, full_turn(24))


@pytest.fixture
def log_slices():
    log = LogModel.random(901)
    return [log.slice_at(height) for height in (60.0, 200.0)]


def test_equal_seeds_give_equal_scans_and_other_seeds_others(geometry, log_slices):
    def sinogram(seed):
        return simulate_sinogram(L_SHAPE, geometry, noise=0.02, seed=seed)

    np.testing.assert_array_equal(sinogram(902), sinogram(902))
    assert (sinogram(902) != sinogram(903)).any()
    one, again = (simulate_stack(log_slices, geometry, seed=904) for _ in range(2))
    np.testing.assert_array_equal(one.counts, again.counts)
    np.testing.assert_array_equal(one.flats, again.flats)
    np.testing.assert_array_equal(one.darks, again.darks)
    assert (one.counts != simulate_stack(log_slices, geometry, seed=905).counts).any()


def test_the_noise_is_the_stated_share_of_the_rms_and_white(geometry):
    clean = simulate_sinogram(L_SHAPE, geometry, seed=906)
    noise = simulate_sinogram(L_SHAPE, geometry, noise=0.05, seed=906) - clean
    # 18 432 samples: a standard deviation is known to 0.5 %, a mean to 0.7 % of it.
    assert noise.std() == pytest.approx(0.05 * math.sqrt(np.mean(clean**2)), rel=0.02)
    assert abs(noise.mean()) < 0.03 * noise.std()
    assert abs(np.mean(noise[:, 1:] * noise[:, :-1])) < 0.03 * noise.var()


def test_the_background_is_added_everywhere(geometry):
    clean = simulate_sinogram(L_SHAPE, geometry, seed=907)
    np.testing.assert_allclose(simulate_sinogram(L_SHAPE, geometry, background=3.3, seed=907), clean + 3.3, atol=1e-12)


def test_a_cell_sees_several_rays(geometry):
    """Many rays converge on the mean over the cell; the default stands close to it and is not the same."""
    mean = analytic.project(L_SHAPE, DetectorCells.of(geometry.scanner), geometry.frame, geometry.angles_rad)
    rms = [
        float(np.sqrt(np.mean((simulate_sinogram(L_SHAPE, geometry, rays_per_cell=n, seed=908) - mean) ** 2)))
        for n in (1, 8, 64)
    ]
    assert rms[0] > 4.0 * rms[1] > 0.0
    assert rms[1] > 4.0 * rms[2]


@pytest.mark.parametrize("noise", [-0.01, math.nan, math.inf])
def test_an_impossible_noise_is_refused(geometry, noise):
    with pytest.raises(GeometryError, match="noise must be a share of the RMS, zero or more"):
        simulate_sinogram(L_SHAPE, geometry, noise=noise, seed=0)


def test_counts_come_back_as_line_integrals_within_their_photon_noise(geometry, log_slices):
    photons = 30_000.0
    stack = simulate_stack(log_slices, geometry, photons=photons, fields=200, seed=909)
    assert (stack.counts.shape, stack.counts.dtype) == ((24, 2, 768), np.uint16)
    back = line_integrals(*(a.astype(np.float32) for a in (stack.counts, stack.flats, stack.darks))).stack
    cells = DetectorCells.of(geometry.scanner)
    for row, body in enumerate(log_slices):
        truth = analytic.project(body, cells, geometry.frame, geometry.angles_rad)
        signal = photons * np.exp(-truth)
        # Photon noise, and the electronics' five counts; 200 flat and dark fields add next to nothing.
        pull = (back[:, row] - truth) / np.sqrt(1.0 / signal + 25.0 / signal**2)
        # 18 432 samples; gains differ by 3 %, so by 1.5 % the noise; the rim's partial volume pulls single cells.
        assert np.median(np.abs(pull)) / 0.6745 == pytest.approx(1.0, abs=0.03)
        assert abs(np.median(pull)) < 0.05


def test_partial_volume_raises_the_transmission(geometry):
    """The mean intensity over a cell is at least that of the mean line integral (Jensen), and more at steep edges."""
    body = Phantom("steep", (*(Disc((x, 0.0), 1.0, 2.0) for x in range(-60, 61, 6)),))
    stack = simulate_stack([body], geometry, photons=50_000.0, fields=200, seed=910)
    back = line_integrals(*(a.astype(np.float32) for a in (stack.counts, stack.flats, stack.darks))).stack[:, 0]
    mean = analytic.project(body, DetectorCells.of(geometry.scanner), geometry.frame, geometry.angles_rad)
    steep = (mean > 0.5) & (mean < 3.0)
    assert np.mean(back[steep] - mean[steep]) < -0.1


def test_air_gives_the_stated_photons_and_dark_the_stated_level(geometry):
    air = Phantom("next to nothing", (Disc((0.0, 0.0), 1.0, 1e-9),))
    stack = simulate_stack([air], geometry, photons=20_000.0, seed=911)
    # Gains of 3 % over 768 cells: 0.1 %.
    assert stack.flats.mean() == pytest.approx(20_200.0, rel=0.005)
    assert stack.counts.mean() == pytest.approx(20_200.0, rel=0.005)
    assert stack.darks.mean() == pytest.approx(200.0, abs=0.5)


def test_more_photons_than_sixteen_bits_hold_are_refused(geometry, log_slices):
    with pytest.raises(GeometryError, match="do not fit 16 bits"):
        simulate_stack(log_slices, geometry, photons=60_000.0, seed=0)
