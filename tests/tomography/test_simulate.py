"""A stack in blocks: each slice once, with no more in memory than was promised."""

import math
import threading
import time

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
from sawmill_tomography.reconstruction import cost
from sawmill_tomography.reconstruction.stack import reconstruct_stack


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


SLICES = 40


@pytest.mark.parametrize("concurrent", [1, 3])
@pytest.mark.parametrize("step", [7, 16, 48])
def test_blocks_cover_the_whole_volume_and_one_at_a_time_they_are_in_order(step, concurrent):
    begun, reported, at_work, most = [], [], set(), []
    lock = threading.Lock()

    def reconstruct(start, stop):
        with lock:
            begun.append((start, stop))
            at_work.add(start)
            most.append(len(at_work))
        yield
        with lock:
            at_work.remove(start)

    reconstruct_stack(SLICES, reconstruct, step=step, concurrent=concurrent, done=reported.append)
    # Threads take blocks in order, but one may wait for the processor before it says so.
    in_order = begun if concurrent == 1 else sorted(begun)
    assert in_order == [(start, min(start + step, SLICES)) for start in range(0, SLICES, step)]
    assert reported == sorted(reported)
    assert reported[-1] == SLICES
    assert max(most) <= concurrent


def test_as_many_blocks_as_asked_for_are_at_work_at_a_time():
    # Each waits for the other two: with fewer at a time none would end, and the barrier breaks.
    together = threading.Barrier(3, timeout=120.0)

    def reconstruct(_start, _stop):
        yield together.wait()

    reconstruct_stack(30, reconstruct, step=5, concurrent=3)


@pytest.mark.parametrize("concurrent", [1, 2])
def test_trouble_in_a_block_comes_out_and_ends_the_work(concurrent):
    begun = []

    def failing(start, _stop):
        begun.append(start)
        time.sleep(0.001)
        if start >= 16:
            raise OSError("the disk went away")
        yield

    with pytest.raises(OSError, match="went away"):
        reconstruct_stack(160_000, failing, step=16, concurrent=concurrent)
    # Besides those at work, threads may have taken others before the trouble was known, but not all 10 000.
    assert len(begun) < 160_000 // 16


def test_a_block_that_nobody_waits_for_any_more_does_not_go_on():
    at_work, over, went_on = threading.Event(), threading.Event(), []

    def reconstruct(start, _stop):
        if start == 0:
            at_work.wait(120.0)
            raise OSError("the disk went away")
        at_work.set()
        # Parts without end, were it not left; the test's own end is far later than the trouble is known.
        while not over.wait(0.001):
            yield
        went_on.append(start)

    deadline = threading.Timer(120.0, over.set)
    deadline.start()
    with pytest.raises(OSError, match="went away"):
        reconstruct_stack(2, reconstruct, step=1, concurrent=2)
    deadline.cancel()
    assert went_on == []


def test_blocks_stay_within_their_memory_and_few_slices_are_shared_out():
    for views, cells, size in ((360, 768, 256), (1800, 2048, 1024), (90, 384, 128), (3600, 4096, 2048)):
        for threads in (1, 2, 16):
            step, concurrent = cost.blocks(views, cells, size, 2500, cost.MEMORY_BYTES, threads)
            assert concurrent <= threads
            needed = concurrent * cost.block_bytes(views, cells, size, step)
            assert (step, concurrent) == (1, 1) or needed <= cost.MEMORY_BYTES
    assert cost.blocks(360, 768, 256, 2500, cost.MEMORY_BYTES, 2) == (32, 2)
    assert cost.blocks(360, 768, 256, 2500, 1, 2) == (1, 1)
    assert cost.blocks(360, 768, 256, 64, cost.MEMORY_BYTES, 2) == (32, 2)
    assert cost.blocks(360, 768, 256, 33, cost.MEMORY_BYTES, 2) == (32, 2)
    # Fewer than a vector are one block, which all threads compute.
    assert cost.blocks(360, 768, 256, 7, cost.MEMORY_BYTES, 2) == (16, 1)


def test_seconds_grow_with_the_work_and_the_pace_corrects_them():
    whole = cost.seconds(360, 768, 256, 2500)
    assert 4.0 < 1000.0 * whole / 2500 < 8.0  # milliseconds a slice on the machine the model was fitted on
    assert whole - cost.SECONDS_A_STACK == pytest.approx(
        25.0 * (cost.seconds(360, 768, 256, 100) - cost.SECONDS_A_STACK)
    )
    assert cost.seconds_left(30.0, 1000, 2500) == pytest.approx(45.0)
