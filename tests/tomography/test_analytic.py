"""A stack in blocks: each slice once, with no more in memory than was promised."""

import math
import threading
import time

import numpy as np
import pytest
from mill_scans import line_integrals

from sawmill_tomography.geometry.geometry import (
    FanBeamGeometry,
    GeometryError,
    Scanner,
    SourceFrame,
    Theta,
    cell_centres_mm,
    to_vector,
)
from sawmill_tomography.phantoms.built_in import L_SHAPE, RECTANGLE_WITH_HOLE
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.phantoms.phantom import Disc, Phantom, Polygon
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_tomography.projection.simulate import simulate_sinogram, simulate_stack
from sawmill_tomography.reconstruction import cost
from sawmill_tomography.reconstruction.stack import reconstruct_stack

R_S = 859.46
OVERLAPPING = Phantom(
    "overlapping",
    (
        Polygon(((-80.0, -60.0), (90.0, -40.0), (40.0, 70.0)), 0.7),
        Polygon(((-20.0, 80.0), (60.0, 10.0), (-70.0, -30.0)), 1.3),
        Disc((10.0, 5.0), 55.0, 0.4),
        Disc((25.0, 0.0), 20.0, -0.9),
    ),
)
PHANTOMS = (L_SHAPE, RECTANGLE_WITH_HOLE, OVERLAPPING)
by_name = pytest.mark.parametrize("phantom", PHANTOMS, ids=lambda phantom: phantom.name)


@pytest.fixture
def cells(scanner):
    return DetectorCells.of(scanner)


@pytest.fixture
def frame(theta):
    return theta.source_frame(R_S)


def rays(geometry):
    """Sources (views, 1, 2) and unit directions (views, cells, 2), from theta and not from the source frame."""
    source, centre, axis = geometry.vectors()
    ends = centre[:, None, :] + cell_centres_mm(geometry.scanner)[None, :, None] * axis[:, None, :]
    along = ends - source[:, None, :]
    return source[:, None, :], along / np.linalg.norm(along, axis=-1, keepdims=True)


def test_a_disc_seen_by_single_rays_is_its_chord(scanner, theta, full_turn, cells):
    geometry = FanBeamGeometry(scanner, theta, full_turn(7))
    centre, radius, density = np.array([35.0, -60.0]), 41.0, 1.7
    source, along = rays(geometry)
    to_centre = centre - source
    distance = along[..., 0] * to_centre[..., 1] - along[..., 1] * to_centre[..., 0]
    disc = Phantom("disc", (Disc(tuple(centre), radius, density),))
    seen = analytic.project(disc, cells, geometry.frame, geometry.angles_rad, rays_per_cell=1)
    # The square root magnifies the rounding of the distance (1e-13 mm) near the rim.
    np.testing.assert_allclose(seen, 2.0 * density * np.sqrt(np.maximum(radius**2 - distance**2, 0.0)), atol=1e-5)


def test_a_rectangle_seen_by_single_rays_is_the_slab_between_its_sides(scanner, theta, full_turn, cells):
    geometry = FanBeamGeometry(scanner, theta, full_turn(7))
    low, high = np.array([-70.3, -20.1]), np.array([55.7, 91.9])
    source, along = rays(geometry)
    to_low, to_high = (low - source) / along, (high - source) / along
    leaves = np.maximum(to_low, to_high).min(axis=-1)
    rectangle = Phantom(
        "rectangle", (Polygon(((low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1]))),)
    )
    seen = analytic.project(rectangle, cells, geometry.frame, geometry.angles_rad, rays_per_cell=1)
    np.testing.assert_allclose(seen, np.maximum(leaves - np.minimum(to_low, to_high).max(axis=-1), 0.0), atol=1e-8)


@by_name
def test_the_mean_over_a_cell_is_the_mean_of_many_rays(phantom, cells, frame, full_turn):
    angles = full_turn(11)
    mean = analytic.project(phantom, cells, frame, angles)
    many = analytic.project(phantom, cells, frame, angles, rays_per_cell=64)
    # The midpoint rule of 64 rays misses half a ray's share (1/128) of the steepest jump inside a cell, 350 mm where
    # a side is seen along its length; everywhere else it is far closer.
    assert np.abs(many - mean).max() < 350.0 / 128.0
    assert np.sqrt(np.mean((many - mean) ** 2)) < 0.02


@by_name
def test_the_derivative_is_the_slope_of_the_projection(phantom, cells, frame, irregular_turn):
    angles = irregular_turn(13, 201)
    rows = analytic.project(phantom, cells, frame, angles, position_mm=(3.0, -2.0), derivatives=True)
    slopes, value = rows[:7], rows[7]
    np.testing.assert_allclose(
        value, analytic.project(phantom, cells, frame, angles, position_mm=(3.0, -2.0)), atol=1e-9
    )
    start = np.concatenate([to_vector(frame), (3.0, -2.0)])
    for index, step in enumerate([1e-6, 1e-3, 1e-3, 1e-3, 1e-6, 1e-3, 1e-3]):
        ends = []
        for sign in (1.0, -1.0):
            x = start.copy()
            x[index] += sign * step
            moved = SourceFrame.from_vector(x[:5])
            ends.append(analytic.project(phantom, cells, moved, angles, position_mm=(x[5], x[6])))
        numeric = (ends[0] - ends[1]) / (2.0 * step)
        # Central differences of 1e-3 mm, and the quadrature's own 2e-6: a thousandth of the whole derivative.
        assert np.linalg.norm(slopes[index] - numeric) < 1e-3 * np.linalg.norm(numeric), index


def test_the_gram_matrices_are_the_inner_products_of_the_derivatives(cells, frame, full_turn):
    angles = full_turn(5)
    data = np.random.default_rng(202).standard_normal((5, cells.count))
    rows = analytic.project(OVERLAPPING, cells, frame, angles, position_mm=(1.0, 2.0), derivatives=True)
    rows = np.concatenate([rows[:8], np.ones_like(data)[None], data[None]])
    expected = np.einsum("pkm,qkm->kpq", rows, rows)
    grams = analytic.gram(OVERLAPPING, cells, frame, angles, data, position_mm=(1.0, 2.0))
    size = np.sqrt(np.einsum("kpp,kqq->kpq", expected, expected))
    # Sums of 768 products, relative to the lengths of their factors.
    assert (np.abs(grams - expected) <= 1e-12 * size).all()


def test_whole_cells_are_summed_over_the_edges_as_single_rays_are_edge_by_edge(cells, frame, full_turn):
    angles, position = full_turn(12) + 0.3, (3.0, -2.0)
    means, single = (
        analytic.project(L_SHAPE, cells, frame, angles, position_mm=position, rays_per_cell=rays, derivatives=True)
        for rays in (None, 1)
    )
    alike = (np.abs(means - single) <= 1e-12 * np.abs(single).max(axis=(1, 2), keepdims=True)).all(axis=0)
    # A cell's mean is the ray in its middle, but where an edge ends in it or lies almost along the rays.
    assert alike[single[7] > 0.0].mean() > 0.9


@pytest.mark.parametrize(("row", "aspect", "shear"), [(10, 1e-5, 0.0), (11, 0.0, 1e-5)])
def test_the_derivatives_by_aspect_and_shear_are_those_of_a_deformed_body(cells, frame, full_turn, row, aspect, shear):
    angles, position = full_turn(7), np.linspace((0.0, 3.0), (5.0, -2.0), 7)
    # Discs become polygons when they are deformed: a body of polygons, so that both ends have the same shape.
    body = OVERLAPPING.deformed(1e-9, 0.0)
    rows = analytic.project(body, cells, frame, angles, position_mm=position, derivatives=True)
    ends = [
        analytic.project(body.deformed(sign * aspect, sign * shear), cells, frame, angles, position_mm=position)
        for sign in (1.0, -1.0)
    ]
    numeric = (ends[0] - ends[1]) / (2.0 * max(aspect, shear))
    assert np.linalg.norm(rows[row] - numeric) < 1e-3 * np.linalg.norm(numeric)


def test_a_disc_s_derivatives_by_aspect_and_shear_are_those_of_its_polygon(cells, frame, full_turn):
    disc = Phantom("disc", (Disc((30.0, -20.0), 60.0),))
    rows, cornered = (
        analytic.project(body, cells, frame, full_turn(5), derivatives=True) for body in (disc, disc.deformed(1e-9, 0))
    )
    # Of 96 corners: chords near the rim differ by up to a twentieth of a per cent of the radius.
    for row in (10, 11):
        assert np.linalg.norm(rows[row] - cornered[row]) < 0.02 * np.linalg.norm(rows[row])


@pytest.mark.parametrize("width", [0.2, 0.7, 3.0])
def test_the_taps_of_a_blur_have_its_sum_and_its_variance(width):
    taps = analytic.blur_taps(width)
    both = np.concatenate([taps[:0:-1], taps])
    place = np.arange(both.size) - taps.size + 1
    assert both.sum() == pytest.approx(1.0, abs=1e-12)
    # What lies beyond four and a half widths is cut off.
    assert (both * place**2).sum() == pytest.approx(width**2, rel=1e-3)


@by_name
def test_a_moved_body_the_sum_of_its_shapes_and_its_corners_the_other_way_round_are_seen_alike(
    phantom, cells, frame, full_turn
):
    def seen(body, **at):
        return analytic.project(body, cells, frame, full_turn(8), **at)

    at, moved = seen(phantom, position_mm=(12.5, -7.25)), seen(phantom.moved(12.5, -7.25))
    np.testing.assert_allclose(at, moved, atol=1e-9)
    parts = [seen(Phantom("part", (shape,))) for shape in phantom.shapes]
    np.testing.assert_allclose(sum(parts), seen(phantom), atol=1e-9)
    turned = [
        Polygon(shape.vertices_mm[::-1], shape.density) if isinstance(shape, Polygon) else shape
        for shape in phantom.shapes
    ]
    np.testing.assert_allclose(seen(Phantom("reversed", tuple(turned))), seen(phantom), atol=1e-9)


def test_a_polygon_of_very_many_corners_is_a_disc(cells, frame, full_turn):
    turn = np.arange(720) * 2.0 * math.pi / 720
    # The polygon of the disc's own area: its sides then miss the rim by at most r (1 - cos(pi / 720)) = 1e-3 mm.
    radius = 80.0 / math.sqrt(math.sin(turn[1]) / turn[1])
    corners = tuple((10.0 + radius * math.cos(a), -5.0 + radius * math.sin(a)) for a in turn)
    round_one = analytic.project(Phantom("disc", (Disc((10.0, -5.0), 80.0),)), cells, frame, full_turn(5))
    cornered = analytic.project(Phantom("polygon", (Polygon(corners),)), cells, frame, full_turn(5))
    # Near the rim a chord of 2 sqrt(2 r e) belongs to a miss of e: averaged over a cell, below a tenth of a mm.
    np.testing.assert_allclose(cornered, round_one, atol=0.1)
    assert np.abs(cornered - round_one).mean() < 1e-3


@by_name
def test_cells_taken_together_see_the_mean(phantom, scanner, frame, full_turn):
    fine = analytic.project(phantom, DetectorCells.of(scanner), frame, full_turn(6))
    coarse = analytic.project(phantom, DetectorCells.of(scanner, binned=4), frame, full_turn(6))
    # A wide cell's quadrature is exact to 2e-6 of the distance from the source, about 1000 mm.
    np.testing.assert_allclose(coarse, fine.reshape(6, -1, 4).mean(axis=2), atol=5e-3)


def test_a_remainder_of_cells_is_left_out_at_the_far_end():
    cells = DetectorCells.of(Scanner(500.0, 10, 2.0), binned=3)
    assert (cells.first_border_mm, cells.width_mm, cells.count) == (-10.0, 6.0, 3)


def test_a_phantom_beside_the_detector_casts_no_shadow(scanner, full_turn):
    frame = Theta(0.0, 700.0, 0.0, 3000.0, 0.0).source_frame(R_S)
    assert not analytic.project(L_SHAPE, DetectorCells.of(scanner), frame, full_turn(4)).any()


def test_a_phantom_that_reaches_the_source_is_refused(cells, full_turn):
    with pytest.raises(GeometryError, match="touches the source"):
        analytic.project(L_SHAPE, cells, SourceFrame(0.0, 170.0, 800.0, 0.0, 0.0), full_turn(4))
    near = SourceFrame(0.0, 300.0, 800.0, 0.0, 0.0)
    assert analytic.project(L_SHAPE, cells, near, full_turn(4)).any()
    with pytest.raises(GeometryError, match="touches the source"):
        analytic.project(L_SHAPE, cells, near, full_turn(4), position_mm=(150.0, 0.0))


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
    seen = [simulate_sinogram(L_SHAPE, geometry, rays_per_cell=rays, seed=908) for rays in (1, 8, 64)]
    rms = [float(np.sqrt(np.mean((sinogram - mean) ** 2))) for sinogram in seen]
    assert rms[0] > 4.0 * rms[1] > 0.0
    assert rms[1] > 4.0 * rms[2]


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


def test_an_impossible_noise_and_more_photons_than_sixteen_bits_hold_are_refused(geometry, log_slices):
    for noise in (-0.01, math.nan, math.inf):
        with pytest.raises(GeometryError, match="noise must be a share of the RMS, zero or more"):
            simulate_sinogram(L_SHAPE, geometry, noise=noise, seed=0)
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
