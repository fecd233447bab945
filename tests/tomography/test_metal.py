"""Nails in simulated logs: found, taken out and put back in slices, left out and named in drift checks."""

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
import scipy
from exact_chords import Detector, scan
from mill_scans import line_integrals
from missing_parts import first_by_day
from nailed_logs import SCANNER, Nail, NailedLog, views_all_round
from production_logs import STEEL_PER_MM, log_shapes
from scipy.ndimage import binary_dilation

from sawmill_tomography.drift.change import DriftError
from sawmill_tomography.drift.detector_fit import detector_fit
from sawmill_tomography.drift.view_pairs.behind_metal import rays_behind_metal
from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, Scanner, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.projection.simulate import simulate_stack
from sawmill_tomography.reconstruction.metal import MetalSearch
from sawmill_tomography.reconstruction.object_extent import object_radius_mm
from sawmill_tomography.sinograms.present_rows import bridged_samples
from sawmill_vocabulary import Rotation

pytestmark = pytest.mark.usefixtures("one_thread")

MILL = Scanner(source_to_cor_mm=859.46, num_detector_pixels=288, detector_pitch_mm=2.0)
THETA = Theta(0.7, 715.0, 40.0, 10.0, 0.05)
WOOD = LogModel.random(3, radius_mm=105.0).slice_at(60.0).moved(4.0, -3.0)
METAL_PER_MM = 0.3
NAILS = (Disc((60.0, 20.0), 2.0, METAL_PER_MM), Disc((-30.0, -55.0), 2.5, METAL_PER_MM))
NAILED = Phantom("nailed", (*WOOD.shapes, *NAILS))


def simulated(body, views, seed=5):
    fan = FanBeamGeometry(MILL, THETA, (np.arange(views) + 0.5) * TAU / views)
    stack = simulate_stack([body], fan, photons=20_000.0, seed=seed)
    counts, flats, darks = (frames.astype(np.float32) for frames in vars(stack).values())
    return line_integrals(counts, flats, darks).stack[:, 0], fan


def search(lines, fan):
    made = MetalSearch.of(fan, object_radius_mm(fan, lines))
    assert made is not None
    return made


@cache
def seen(views):
    lines, fan = simulated(NAILED, views)
    return search(lines, fan).find(lines[None])[0], lines, fan


@pytest.mark.parametrize("views", [12, 90])
def test_nails_are_found_and_taken_out(views):
    metal, lines, fan = seen(views)
    plain, _ = simulated(WOOD, views)
    assert search(lines, fan).find(plain[None])[0] is None
    assert len(metal.body.rows) == len(NAILS)
    # A nail shades 5 to 7 of 288 cells, with the margin 10 to 12: two of them at most a twelfth.
    assert 0.03 < metal.trace.mean() < 1.0 / 12.0
    assert np.array_equal(metal.filled[~metal.trace], lines[~metal.trace])
    # What is left of 1.2 in the middle of a nail: the noise (0.03) and the rings, which no interpolation knows.
    assert np.sqrt(np.mean((metal.filled - plain)[metal.trace] ** 2)) < 0.1


def test_the_metal_is_put_back_with_its_mass_on_any_grid():
    metal, *_ = seen(90)
    mass = METAL_PER_MM * np.pi * sum(nail.radius_mm**2 for nail in NAILS)
    for grid in (ImageGrid(48, 240.0), ImageGrid(200, 240.0, (10.0, -6.0))):
        # Cells average intensities, and steel shades more than its mass: a few per cent.
        assert metal.body.on(grid).sum() * grid.pixel_mm**2 == pytest.approx(mass, rel=0.15)


def taken(log, fan, seed=1):
    """The metal found in a slice of the log, and which rays cross its nails."""
    lines = log.scan(fan, seed)[:, 0]
    through = (log.line_integrals(fan) > log.plain.line_integrals(fan)).any(axis=-1)
    return search(lines, fan).find(lines[None])[0], through


FOUR = Nail(3.2, 18.0, 20.0), Nail(6.0, 30.0, 50.0), Nail(2.0, 6.0, 50.0), Nail(3.4, 75.0, 50.0)
BY_DAY = [(1, 12, FOUR[0]), (1, 30, FOUR[1]), (1, 30, FOUR[2]), (1, 12, FOUR[3])]
BY_NIGHT = [each for each in product((1, 2), (12, 30), FOUR) if each not in BY_DAY]


@pytest.mark.parametrize("case", first_by_day(4, BY_DAY + BY_NIGHT))
def test_the_rays_that_are_taken_are_those_through_the_nail(case):
    seed, views, nail = case
    metal, through = taken(NailedLog.random(seed, nail), views_all_round(views))
    # A few cells on either side of a shadow of 5 to 110 cells; where the nail's corner is crossed it hardly shades.
    assert (metal.trace & through).sum() > 0.95 * through.sum()
    assert (metal.trace & ~binary_dilation(through, np.ones((1, 9)))).mean() < 0.005


@pytest.mark.parametrize("nail", [Nail(2.0, 6.0, 50.0), Nail(3.4, 75.0, 50.0)])
def test_a_straight_nail_is_measured_to_a_tenth_of_a_millimetre(nail):
    """Twelve views in counts, cells of 0.8 mm at the COR."""
    log, fan = NailedLog.random(1, nail), views_all_round(12)
    metal, _ = taken(log, fan)
    (row,), (true,) = metal.body.rows, log.nails
    length_mm, thickness_mm, per_mm = np.exp(row[3:])
    # Of 32 such scans (four nails, four logs, 12 and 30 views) one missed more: the thickness, by 0.8 mm.
    assert np.hypot(*(row[:2] - true.centre_mm)) < 0.1
    assert (length_mm, thickness_mm) == pytest.approx((nail.length_mm, nail.diameter_mm), abs=0.2)
    # Starved rays say less than there is, which the fit takes for a little hardening: up to 11 % too much.
    assert length_mm * thickness_mm * per_mm == pytest.approx(nail.length_mm * nail.diameter_mm * true.per_mm, rel=0.15)


def test_metal_that_is_not_straight_is_taken_out_as_well():
    """Two rods at a right angle are not one rod, and from 12 views no sharp pixels."""
    fan, straight = views_all_round(12), NailedLog.random(1, Nail(4.0, 30.0, 50.0))
    (one,) = straight.nails
    along = np.array([np.cos(one.direction_rad), np.sin(one.direction_rad)])
    centre = tuple((np.array(one.centre_mm) + 15.0 * along + 15.0 * np.array([-along[1], along[0]])).tolist())
    log = replace(straight, nails=(one, replace(one, centre_mm=centre, direction_rad=one.direction_rad + 0.5 * np.pi)))
    metal, _ = taken(log, fan)
    wood, wood_and_metal = (np.exp(-each.line_integrals(fan)).mean(axis=-1) for each in (log.plain, log))
    exact = np.log(wood / wood_and_metal)
    thin = metal.trace & (exact > 0.3) & (exact < 5.0)
    # 0.31 here; 0.16 to 0.27 in four logs with nails that are bent by a right angle in their middle. What is missed is
    # known: these rays count accordingly less, or not at all.
    assert np.linalg.norm(metal.body.line_integrals(fan, thin) - exact[thin]) < 0.4 * np.linalg.norm(exact[thin])
    assert metal.misfit > 2.0


@pytest.mark.parametrize("nail", first_by_day(1, [Nail(3.4, 75.0, 20.0), Nail(4.2, 100.0, 50.0)]))
def test_the_wood_behind_a_long_nail_is_that_of_the_other_rays(nail):
    """Half the cells of a view may be behind it: straight lines between their ends know nothing of the wood there."""
    fan, missed, by_lines = views_all_round(20), [], []
    for seed in (2, 3):
        log = NailedLog.random(seed, nail)
        metal, through = taken(log, fan, seed)
        assert (metal.trace & through).sum() > 0.97 * through.sum()
        wood = log.plain.line_integrals(fan).mean(axis=-1)
        missed.append((metal.filled - wood)[metal.trace])
        by_lines.append((bridged_samples(wood, metal.trace) - wood)[metal.trace])
    # 0.43 and 0.46 times: some of the wood behind a nail is behind it in every view.
    assert np.linalg.norm(np.concatenate(missed)) < 0.6 * np.linalg.norm(np.concatenate(by_lines))


@pytest.mark.parametrize(("views", "logs"), [(12, 6), pytest.param(45, 2, marks=pytest.mark.nightly)])
def test_knots_and_noise_are_no_metal(views, logs):
    fan = views_all_round(views)
    for seed in range(logs):
        metal, _ = taken(NailedLog.random(seed), fan, seed)
        assert metal is None
    air = 0.02 * np.random.default_rng(views).standard_normal(fan.sinogram_shape).astype(np.float32)
    looking = MetalSearch.of(fan, 120.0)
    assert (looking.find(air[None])[0], looking.find(np.zeros_like(air)[None])[0]) == (None, None)


@pytest.mark.parametrize("views", [12, 30, 360])
def test_nothing_in_the_published_log_is_metal(views, log_sinogram, scanner, theta, full_turn):
    every = 360 // views
    lines = log_sinogram[::every].astype(np.float32)
    assert search(lines, FanBeamGeometry(scanner, theta, full_turn(360)[::every])).find(lines[None])[0] is None


def test_a_part_of_a_turn_shows_metal_and_a_handful_of_views_does_not():
    lines, fan = simulated(NAILED, 90)
    part = fan.with_angles(0.25 * fan.angles_rad)
    stack = simulate_stack([NAILED], part, photons=20_000.0, seed=5)
    counts, flats, darks = (frames.astype(np.float32) for frames in vars(stack).values())
    seen = line_integrals(counts, flats, darks).stack[:, 0]
    assert search(seen, part).find(seen[None])[0] is not None
    assert MetalSearch.of(fan.with_angles(fan.angles_rad[:7]), object_radius_mm(fan, lines)) is None


ROWS = 60


def test_rays_behind_nails_are_those_of_the_log_and_their_errors_are_known():
    fan, detector = views_all_round(20), Detector(SCANNER.num_detector_pixels, SCANNER.detector_pitch_mm)
    missed, straight, expected = [], [], []
    for seed in range(4):
        shapes = log_shapes(np.random.default_rng(seed), nails=True)
        wood = [shape for shape in shapes if shape.density != STEEL_PER_MM]
        with_nails, log = (-np.log(scan(bodies, detector, fan.frame, fan.angles_rad)) for bodies in (shapes, wood))
        metal = scipy.ndimage.binary_dilation(with_nails - log > 0.003, [[True] * 3])
        behind = rays_behind_metal(SCANNER, with_nails, fan.angles_rad, fan.frame, metal)
        assert np.array_equal(behind.rays[~metal], with_nails[~metal])
        missed += np.sum(behind.rays - log, axis=1).tolist()
        straight += np.sum(bridged_samples(with_nails, metal) - log, axis=1).tolist()
        # The sums of views are what pairs compare.
        expected += np.bincount(behind.of_view, np.sum(behind.errors, axis=1) ** 2, len(fan.angles_rad)).tolist()
    rms, rms_straight, stated = (np.sqrt(np.mean(each)) for each in (np.square(missed), np.square(straight), expected))
    # The other views place the knots behind a nail: these logs miss 0.13, linear interpolation 0.57.
    assert rms < 0.4 * rms_straight
    # 20 views of 4 logs, whose errors are alike in a log; the known runs lie elsewhere in it.
    assert 0.5 < stated / rms < 2.0


def checked(log, fan, seed):
    mean = log.scan(fan, seed, ROWS).mean(axis=1, dtype=np.float64)
    return detector_fit(SCANNER, mean, fan.angles_rad, fan.frame, Rotation.AS_GIVEN)


SHORT = [(Nail(3.6, 28.0, 20.0), 0.4), (Nail(5.0, 0.0, 30.0), 0.1), (Nail(2.8, 50.0, 40.0), 0.4)]


CASES = [(20, Nail(3.4, 75.0, 40.0), 0.6), *((views, *short) for views in (12, 20) for short in SHORT)]


@pytest.mark.parametrize("case", first_by_day(2, CASES))
def test_a_nail_in_every_row_is_left_out_and_named(case):
    """They were refused as logs that moved."""
    views, nail, worst_mm = case
    fan = views_all_round(views)
    for seed in range(2):
        fit = checked(NailedLog.random(seed, nail), fan, seed)
        assert abs(fit.cor_column_mm - fan.frame.cor_column_mm) < 3.0 * fit.deviation[0] < worst_mm
        assert any(remark.startswith("metal in the log: ") for remark in fit.adjustments)
        # The edge of a narrow shadow is no faulty cell.
        assert not any("detector cells" in remark for remark in fit.adjustments)


def test_a_log_full_of_metal_is_refused_by_that_name():
    fan = views_all_round(20)
    with pytest.raises(DriftError, match=r"metal in the log covers \d\d% of the samples, and 20% may") as refusal:
        checked(NailedLog.random(1, *[Nail(6.0, 30.0, 30.0)] * 12), fan, 1)
    assert refusal.value.code == "metal-in-log"
