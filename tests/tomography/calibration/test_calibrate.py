import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from mill_scans import line_integrals
from missing_parts import first_by_day

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.fit import refine
from sawmill_tomography.calibration.refusals import CalibrationError
from sawmill_tomography.calibration.sinogram_data import SinogramData
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import (
    TAU,
    FanBeamGeometry,
    Scanner,
    Theta,
    ThetaBounds,
    angle_difference,
    to_vector,
    wrap_angle,
)
from sawmill_tomography.geometry.ray_error import predicted_ray_error, ray_error
from sawmill_tomography.phantoms.built_in import BUILT_IN, L_SHAPE, RECTANGLE_WITH_HOLE
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM
from sawmill_tomography.phantoms.phantom import Disc, Phantom, Polygon
from sawmill_tomography.phantoms.tracing import trace
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_tomography.projection.simulate import simulate_sinogram, simulate_stack
from sawmill_vocabulary import Adjustment, Handedness, Rotation

pytestmark = pytest.mark.slow

nightly = pytest.mark.nightly
seeds_2_or_20 = pytest.mark.parametrize("seeds", [range(2), pytest.param(range(20), marks=nightly)], ids=len)
seeds_6_or_20 = pytest.mark.parametrize("seeds", [range(6), pytest.param(range(20), marks=nightly)], ids=len)
both_phantoms = pytest.mark.parametrize("phantom", BUILT_IN.values(), ids=BUILT_IN)
by_night_the_other = pytest.mark.parametrize(
    "phantom", [L_SHAPE, pytest.param(RECTANGLE_WITH_HOLE, marks=nightly)], ids=["l-shape", "rectangle-with-hole"]
)


@pytest.fixture
def scan(scanner, theta):
    """A noisy scan of a phantom as its task: eight rays a cell, where the model averages over the cell."""

    def make(phantom, angles, *, seed, theta=theta, scanner=scanner, noise=0.02, given=None, drawn=None, **asked):
        sinogram = simulate_sinogram(phantom, FanBeamGeometry(scanner, theta, angles), noise=noise, seed=seed)
        return CalibrationTask(scanner, drawn or phantom, sinogram, angles if given is None else given, **asked)

    return make


def errors(calibration, theta, *, radius_mm=150.0):
    """RMS ray error in mm and the error of psi in degrees."""
    scanner = calibration.scanner
    true = theta.source_frame(scanner.source_to_cor_mm)
    psi = angle_difference(calibration.frame.psi_rad, true.psi_rad)
    return ray_error(scanner, true, calibration.frame, radius_mm=radius_mm).rms_mm, abs(math.degrees(psi))


@seeds_2_or_20
def test_the_published_scan_is_calibrated_from_every_seed(scanner, theta, full_turn, l_phantom_sinogram, seeds):
    task = CalibrationTask(scanner, L_SHAPE, l_phantom_sinogram, full_turn(360))
    for seed in seeds:
        found = calibrate(task, seed=seed)
        rays, psi = errors(found, theta)
        # The requirement; 0.05 to 0.06 mm of it is the data's own pixel phantom.
        assert rays < 0.08, seed
        assert psi < 0.1, seed
        assert (found.handedness, found.rotation) == (Handedness.AS_DRAWN, Rotation.AS_GIVEN), seed
        assert found.judgement.verdict == "pass", seed
        # The pixels' steps are not fitted: the level takes up to a third of the drawing's precision, in mm of wood.
        assert found.findings.fit.offset == pytest.approx(3.3477, abs=0.2 / 3.0), seed


@pytest.fixture(scope="module")
def repeats(scanner, theta, full_turn):
    """Calibrate noisy scans, noise and search seeded alike: (phantom, views, seeds) -> list."""

    @cache
    def one(name, views, seed):
        geometry = FanBeamGeometry(scanner, theta, full_turn(views))
        sinogram = simulate_sinogram(BUILT_IN[name], geometry, noise=0.02, seed=seed)
        return calibrate(CalibrationTask(scanner, BUILT_IN[name], sinogram, geometry.angles_rad), seed=seed)

    return lambda name, views, seeds: [one(name, views, seed) for seed in seeds]


@pytest.mark.parametrize("name", BUILT_IN)
@pytest.mark.parametrize(("views", "allowed_mm"), [(360, 0.02), (20, 0.06)])
@seeds_2_or_20
def test_simulated_scans_are_calibrated_from_every_seed(repeats, theta, name, views, allowed_mm, seeds):
    for seed, found in zip(seeds, repeats(name, views, seeds), strict=True):
        rays, psi = errors(found, theta)
        # The requirement.
        assert rays < allowed_mm, seed
        assert psi < 0.1, seed
        assert found.judgement.verdict == "pass", (seed, found.judgement.reasons)
        assert found.search.seed == seed
        assert found.search.history[-1] == (found.search.evaluations, found.search.best_value)
        # 2 % of the RMS of the whole sinogram.
        assert found.findings.fit.residual_rms == pytest.approx(0.02 * np.sqrt(np.mean(found.model**2)), rel=0.05)


@pytest.mark.parametrize("name", BUILT_IN)
@pytest.mark.parametrize("views", [20, pytest.param(360, marks=nightly)])
@seeds_6_or_20
def test_the_predicted_ray_error_is_the_actual_one_on_average(repeats, theta, name, views, seeds):
    found = repeats(name, views, seeds)
    actual = math.sqrt(np.mean([errors(one, theta)[0] ** 2 for one in found]))
    predicted = math.sqrt(np.mean([one.findings.error_bars.predicted_ray_error.rms_mm**2 for one in found]))
    # An RMS of 20 has 15 % of scatter, one of 6 has 30 %, and an inflation from 20 views' residuals errs to the
    # careful side, so far by up to a half.
    assert 0.8 * actual < predicted < 2.0 * actual


def test_the_predicted_ray_error_without_inflation_is_that_of_thirty_noisy_fits(scanner, theta, full_turn):
    geometry = FanBeamGeometry(scanner, theta, full_turn(45))
    true = geometry.frame
    squares, predictions = [], []
    for seed in range(1100, 1130):
        sinogram = simulate_sinogram(L_SHAPE, geometry, noise=0.02, seed=seed)
        fit = refine(L_SHAPE, SinogramData(sinogram, geometry.angles_rad, DetectorCells.of(scanner)), true)
        squares.append(ray_error(scanner, true, fit.frame).rms_mm ** 2)
        predictions.append(predicted_ray_error(scanner, true, fit.covariance.of_frame.values).rms_mm)
    # The root of a mean of 30 squares scatters by about 10 %.
    assert np.mean(predictions) == pytest.approx(math.sqrt(np.mean(squares)), rel=0.3)


@pytest.mark.parametrize("views", [20, pytest.param(360, marks=nightly)])
@seeds_6_or_20
def test_the_covariance_of_the_frame_is_its_scatter(repeats, theta, scanner, views, seeds):
    true = theta.source_frame(scanner.source_to_cor_mm)
    pulls = np.array(
        [
            (to_vector(one.frame) - to_vector(true)) / np.sqrt(np.diag(one.findings.error_bars.covariance.values))
            for one in repeats("l-shape", views, seeds)
        ]
    )
    # The RMS of n standard normal numbers is 1 to 1 / sqrt(2 n), and three times that is allowed.
    np.testing.assert_allclose(np.sqrt((pulls**2).mean(axis=0)), 1.0, atol=3.0 / np.sqrt(2.0 * len(pulls)))


def test_equal_seeds_give_equal_answers(scan, full_turn):
    task = scan(L_SHAPE, full_turn(20), seed=1101)
    one, again = calibrate(task, seed=5), calibrate(task, seed=5)
    np.testing.assert_array_equal(to_vector(one.frame), to_vector(again.frame))
    assert one.search == again.search


@both_phantoms
@pytest.mark.parametrize("handedness", list(Handedness))
@pytest.mark.parametrize("rotation", list(Rotation))
def test_each_of_the_four_hypotheses_is_recovered(scan, theta, full_turn, phantom, handedness, rotation):
    seen = phantom if handedness is Handedness.AS_DRAWN else phantom.mirrored()
    angles = full_turn(24)
    found = calibrate(scan(seen, rotation.apply(angles), seed=1102, given=angles, drawn=phantom))
    assert (found.handedness, found.rotation) == (handedness, rotation)
    hypotheses = found.findings.alternatives.hypotheses
    assert (hypotheses[0].handedness, hypotheses[0].rotation) == (handedness, rotation)
    assert len(hypotheses) == 4
    # The hole says least of which side it is: its wrong hypotheses leave 0.11.
    assert all(other.relative_residual > 0.1 for other in hypotheses[1:])
    assert errors(found, theta)[0] < 0.06


def test_a_hypothesis_that_is_given_is_the_only_one_tried(scan, theta, full_turn):
    given = {"handedness": Handedness.AS_DRAWN, "rotation": Rotation.AS_GIVEN}
    found = calibrate(scan(L_SHAPE, full_turn(24), seed=1103, **given))
    assert len(found.findings.alternatives.hypotheses) == 1
    assert errors(found, theta)[0] < 0.06


@pytest.mark.parametrize(
    ("phantom", "rotation"),
    [(L_SHAPE, Rotation.REVERSED), (RECTANGLE_WITH_HOLE, Rotation.AS_GIVEN), (RECTANGLE_WITH_HOLE, Rotation.REVERSED)],
)
def test_a_wrong_hypothesis_that_is_given_never_passes(scan, full_turn, phantom, rotation):
    given = {"handedness": Handedness.FROM_BEHIND, "rotation": rotation}
    task = scan(phantom, full_turn(24), seed=1104, **given)
    try:
        found = calibrate(task)
    except CalibrationError as error:
        # The fit ran off to a source that no scanner has.
        assert "puts the source at" in str(error)  # noqa: PT017 - either answer is right
    else:
        assert found.frame.source_distance_mm < 2.0 * task.scanner.source_to_cor_mm
        assert found.judgement.verdict != "pass"
        assert any("of the sinogram unexplained, and not as noise" in reason for reason in found.judgement.reasons)


@by_night_the_other
@pytest.mark.parametrize("position", [(20.0, 0.0), (-14.0, 14.0), (0.0, -20.0)])
def test_a_phantom_off_the_centre_is_found_where_it_is(scan, theta, full_turn, phantom, position):
    found = calibrate(scan(phantom.moved(*position), full_turn(24), seed=1106, drawn=phantom))
    assert errors(found, theta)[0] < 0.06
    # A hundredth of a cell.
    np.testing.assert_allclose(found.findings.fit.position_mm, position, atol=0.1)
    assert found.seen == phantom.moved(*found.findings.fit.position_mm)


@by_night_the_other
def test_without_source_shift_the_answer_is_held_at_the_known_distance_or_unresolved(scan, theta, full_turn, phantom):
    outcomes = set()
    for shift, seed in ((0.0, 1107), (0.0, 1108), (5.0, 1109), (5.0, 1110), (0.0, 1111), (0.0, 1113), (0.0, 1115)):
        true = replace(theta, source_shift_mm=shift)
        task = scan(phantom, full_turn(20), seed=seed, theta=true)
        found = calibrate(task, seed=seed)
        assert errors(found, true)[0] < 0.06
        distance, bars = found.findings.source_distance, found.findings.error_bars
        outcomes.add(distance.held)
        r_s = task.scanner.source_to_cor_mm
        if distance.held:
            assert found.frame.source_distance_mm == r_s
            assert distance.unconstrained_mm < r_s
            assert found.theta.source_shift_mm == 0.0
            assert found.theta_twin is None
            assert bars.theta_deviation is None
            assert bars.frame_deviation(found.frame)[1] > r_s - distance.unconstrained_mm
            assert any("the source distance was held there" in reason for reason in found.judgement.reasons)
            np.testing.assert_allclose(
                to_vector(found.theta.source_frame(r_s)), to_vector(found.frame), rtol=1e-12, atol=1e-9
            )
        else:
            assert found.frame.source_distance_mm == distance.unconstrained_mm >= r_s
    # Half of the noises put the source nearer: over seven, both happen.
    assert outcomes == {True, False}


OTHER_SCANNERS = {
    "a long one": (Scanner(1200.0, 1024, 0.8), Theta(1.0, 400.0, -150.0, 60.0, 0.1), 0.6, 90.0),
    "one in a laboratory": (Scanner(300.0, 512, 0.4), Theta(4.0, 180.0, 20.0, -8.0, -0.05), 0.2, 35.0),
    "one of few cells": (Scanner(700.0, 200, 5.0), Theta(6.1, 600.0, 100.0, 30.0, -0.3), 1.0, 150.0),
}


@by_night_the_other
@pytest.mark.parametrize("name", OTHER_SCANNERS)
def test_another_scanner_is_calibrated_with_its_own_constants(scan, full_turn, phantom, name):
    scanner, theta, scale, radius = OTHER_SCANNERS[name]
    body = phantom.scaled(scale)
    found = calibrate(scan(body, full_turn(60), seed=1113, theta=theta, scanner=scanner, log_radius_mm=radius))
    rays, psi = errors(found, theta, radius_mm=radius)
    # As for the published one at 20 views; what is small is measured by its own size.
    assert rays < 0.06 * max(scale, 0.5)
    assert psi < 0.1
    assert found.judgement.verdict == "pass"


def test_a_small_phantom_is_judged_in_the_disc_that_held_it(scan, full_turn):
    """Rays that never met it are none of its answer, unless a larger log is stated."""
    scanner, theta, scale, _ = OTHER_SCANNERS["one in a laboratory"]
    task = scan(L_SHAPE.scaled(scale), full_turn(20), seed=1113, theta=theta, scanner=scanner)
    own, stated = calibrate(task), calibrate(replace(task, log_radius_mm=60.0))
    assert own.radius_mm == own.seen.radius_mm == pytest.approx(scale * L_SHAPE.radius_mm, abs=5.0)
    assert stated.radius_mm == 60.0
    assert own.findings.error_bars.predicted_ray_error.rms_mm < stated.findings.error_bars.predicted_ray_error.rms_mm


@by_night_the_other
def test_irregular_angles_in_any_order_and_of_any_turn_are_the_views_own(scan, theta, phantom):
    rng = np.random.default_rng(1114)
    angles = rng.permutation(np.sort(rng.uniform(0.0, TAU, 60))) - 6.0 * TAU
    assert errors(calibrate(scan(phantom, angles, seed=1115)), theta)[0] < 0.06


@by_night_the_other
def test_seventeen_views_suffice(scan, theta, full_turn, phantom):
    assert errors(calibrate(scan(phantom, full_turn(17), seed=1116)), theta)[0] < 0.06


@by_night_the_other
def test_views_over_half_a_turn_suffice(scan, theta, full_turn, phantom):
    rays, psi = errors(calibrate(scan(phantom, full_turn(60) / 2.0, seed=1117)), theta)
    assert rays < 0.1
    assert psi < 0.1


@by_night_the_other
def test_a_phantom_traced_from_a_picture_is_as_good_as_its_picture(scan, theta, full_turn, phantom):
    drawn = trace(phantom.rasterise(1000, 400.0), 400.0, name="picture")
    found = calibrate(scan(phantom, full_turn(60), seed=1118, drawn=drawn))
    # A pixel of 0.4 mm traced to a tenth.
    assert errors(found, theta)[0] < 0.06


def test_a_phantom_half_beside_the_detector_still_calibrates(scan, theta, full_turn):
    true = replace(theta, detector_shift_mm=-330.0)
    found = calibrate(scan(L_SHAPE, full_turn(60), seed=1119, theta=true))
    assert np.ptp(found.model[:, [0, -1]]) > 50.0
    assert errors(found, true)[0] < 0.06


def test_gain_and_background_are_free(scan, full_turn):
    task = scan(L_SHAPE, full_turn(24), seed=1120)
    plain = calibrate(task)
    scaled = calibrate(replace(task, sinogram=1e-4 * task.sinogram + 2.0))
    np.testing.assert_allclose(to_vector(scaled.frame), to_vector(plain.frame), rtol=1e-6)
    assert scaled.findings.fit.gain == pytest.approx(1e-4 * plain.findings.fit.gain, rel=1e-6)
    assert scaled.findings.fit.offset == pytest.approx(2.0 + 1e-4 * plain.findings.fit.offset, abs=1e-8)


def test_a_phantom_assumed_too_large_scales_the_scanner_and_hides_from_the_residual(scan, full_turn):
    task = scan(L_SHAPE, full_turn(60), seed=1121)
    right, wrong = calibrate(task), calibrate(replace(task, phantom=L_SHAPE.scaled(1.005)))
    assert wrong.frame.source_distance_mm == pytest.approx(1.005 * right.frame.source_distance_mm, rel=1e-5)
    assert wrong.findings.fit.relative_residual == pytest.approx(right.findings.fit.relative_residual, rel=1e-4)
    of_size = L_SHAPE.size_tolerance * right.frame.source_distance_mm
    assert right.findings.scale.source_distance_mm == pytest.approx(of_size)


def test_the_bounds_choose_between_theta_and_its_twin(scan, theta, scanner, full_turn):
    twin = theta.twin(scanner.source_to_cor_mm)
    task = scan(L_SHAPE, full_turn(60), seed=1122)
    free = calibrate(task)
    assert free.theta.source_shift_mm > 0.0
    bounded = calibrate(replace(task, bounds=ThetaBounds(source_shift_mm=(-400.0, -200.0))))
    # R is known to 0.5 mm here, so h_S to 1.5 mm and the rest of theta with it.
    np.testing.assert_allclose(to_vector(bounded.theta), to_vector(twin), atol=6.0, rtol=0.01)
    np.testing.assert_allclose(to_vector(bounded.theta_twin), to_vector(free.theta), atol=0.05)
    np.testing.assert_allclose(to_vector(free.theta_twin), to_vector(bounded.theta), atol=0.05)


def test_the_angles_of_the_answer_are_in_the_turn(scan, theta, scanner, full_turn):
    start = wrap_angle(theta.initial_angle_rad - theta.source_frame(scanner.source_to_cor_mm).psi_rad)
    for seed in (1124, 1125, 1126, 1127):
        found = calibrate(scan(L_SHAPE, full_turn(20), seed=seed, theta=replace(theta, initial_angle_rad=start)))
        for angle in (found.frame.psi_rad, found.theta.initial_angle_rad, found.theta_twin.initial_angle_rad):
            assert 0.0 <= angle < TAU


def test_the_residual_and_the_model_make_up_the_scan(scan, full_turn):
    task = scan(L_SHAPE, full_turn(24), seed=1130)
    found = calibrate(task)
    np.testing.assert_allclose(found.model + found.residual, task.sinogram, atol=1e-9)
    assert found.findings.fit.residual_rms == pytest.approx(np.sqrt(np.mean(found.residual**2)), rel=1e-6)


def test_progress_counts_the_generations(scan, full_turn):
    heard = []
    found = calibrate(
        scan(L_SHAPE, full_turn(20), seed=1131), progress=lambda done, most, value: heard.append((done, most, value))
    )
    assert [done for done, _, _ in heard] == list(range(1, len(heard) + 1))
    assert found.search.generations in {len(heard), len(heard) + 1}
    values = [value for _, _, value in heard]
    assert values == sorted(values, reverse=True)


def code_of(task):
    with pytest.raises(CalibrationError) as caught:
        calibrate(task)
    return caught.value.code


DISC = Phantom("disc", (Disc((10.0, 20.0), 100.0),))
FROM_BEHIND = {"handedness": Handedness.FROM_BEHIND, "rotation": Rotation.AS_GIVEN}


@pytest.mark.parametrize(
    ("body", "sign", "asked"),
    [(DISC, 1.0, {}), (RECTANGLE_WITH_HOLE, 1.0, {}), (L_SHAPE, -1.0, {}), (L_SHAPE, 1.0, FROM_BEHIND)],
    ids=["a disc", "the other phantom", "brighter than its surroundings", "from a wrong side that is given"],
)
def test_a_scan_that_is_not_of_the_phantom_is_not_calibrated(scan, full_turn, body, sign, asked):
    task = scan(body, full_turn(24), seed=1105, drawn=L_SHAPE, **asked)
    assert code_of(replace(task, sinogram=sign * task.sinogram)) == "phantom-not-seen"


def test_noise_is_not_calibrated(scanner, full_turn):
    noise = np.random.default_rng(1133).standard_normal((20, 768))
    assert code_of(CalibrationTask(scanner, L_SHAPE, noise, full_turn(20))) == "phantom-not-seen"


def test_a_shadow_that_misses_the_detector_is_not_calibrated(scan, theta, full_turn):
    beside = replace(theta, detector_shift_mm=3000.0)
    with pytest.raises(CalibrationError, match="nothing was scanned") as caught:
        scan(L_SHAPE, full_turn(20), seed=1138, theta=beside)
    assert caught.value.code == "flat-scan"


def test_bounds_that_show_nothing_of_the_centre_are_refused(full_turn):
    narrow = Scanner(859.46, 64, 1.5)
    noise = np.random.default_rng(1140).standard_normal((20, 64))
    bounds = ThetaBounds(source_shift_mm=(-10.0, 10.0), detector_shift_mm=(400.0, 500.0), detector_tilt=(-0.1, 0.1))
    assert code_of(CalibrationTask(narrow, L_SHAPE, noise, full_turn(20), bounds=bounds)) == "no-geometry"


NOISE = np.random.default_rng(1141).standard_normal((60, 768))
EVEN = np.arange(60.0)


def put(array, place, value):
    changed = array.copy()
    changed[place] = value
    return changed


REFUSED = {
    "fewer cells": (NOISE[:, 1:], EVEN, "other-detector"),
    "one axis": (NOISE[:, 0], EVEN, "other-detector"),
    "fewer angles": (NOISE, EVEN[1:], "angles-mismatch"),
    "two views": (NOISE[:2], EVEN[:2], "too-few-views"),
    "a NaN": (put(NOISE, (3, 5), np.nan), EVEN, "not-finite"),
    "an infinity": (put(NOISE, (3, 5), np.inf), EVEN, "not-finite"),
    "an angle of NaN": (NOISE, put(EVEN, 4, np.nan), "not-finite"),
    "an infinite angle": (NOISE, put(EVEN, 4, np.inf), "not-finite"),
    "one value": (np.full((60, 768), 4.0), EVEN, "flat-scan"),
}


@pytest.mark.parametrize(("data", "angles", "code"), REFUSED.values(), ids=REFUSED)
def test_data_that_are_no_scan_are_refused(scanner, data, angles, code):
    with pytest.raises(CalibrationError) as caught:
        CalibrationTask(scanner, L_SHAPE, data, angles)
    assert caught.value.code == code
    assert code != "flat-scan" or "every value of the sinogram is 4" in str(caught.value)


def test_views_that_do_not_determine_the_geometry_are_refused_as_too_few(scan):
    """The drive stood still: eight views, and all of them the same."""
    task = scan(L_SHAPE, np.full(8, 0.4), seed=1143)
    with pytest.raises(CalibrationError, match="the 8 views do not determine the geometry") as caught:
        calibrate(task)
    assert caught.value.code == "too-few-views"


def test_views_within_half_a_degree_are_not_taken_for_a_calibration(scan):
    found = calibrate(scan(L_SHAPE, 0.4 + 1e-3 * np.arange(8), seed=1144))
    assert (found.judgement.status, found.judgement.verdict) == ("imprecise", "fail")


NEARLY_ITSELF = {
    "a small hole": (Phantom("small hole", (RECTANGLE_WITH_HOLE.shapes[0], Disc((-50.0, -49.0), 9.0, -1.0))), 60),
    "a triangle of nearly equal sides": (
        Phantom("triangle", (Polygon(((-100.0, -80.0), (120.0, -60.0), (-20.0, 110.0))),)),
        180,
    ),
}


@pytest.mark.parametrize("name", NEARLY_ITSELF)
@pytest.mark.parametrize("seed", first_by_day(1, range(1150, 1153)))
def test_a_body_that_is_nearly_itself_after_part_of_a_turn_is_found_at_the_right_one(
    scan, theta, full_turn, name, seed
):
    body, views = NEARLY_ITSELF[name]
    rays, psi = errors(calibrate(scan(body, full_turn(views), seed=seed), seed=seed), theta)
    assert rays < 0.06
    assert psi < 0.1


def test_a_parallelogram_may_be_half_a_turn_off_and_that_is_reported(scan, full_turn):
    """It is itself after half a turn, but no mirror image of itself: only the first angle is in doubt."""
    body = Phantom("parallelogram", (Polygon(((-120.0, -60.0), (60.0, -60.0), (120.0, 60.0), (-60.0, 60.0))),))
    found = calibrate(scan(body, full_turn(60), seed=1161))
    assert (found.judgement.status, found.judgement.verdict) == ("ambiguous-turn", "watch")
    assert any("turned by 180 degrees" in reason for reason in found.judgement.reasons)


@pytest.mark.parametrize("body", [L_SHAPE, RECTANGLE_WITH_HOLE])
@pytest.mark.parametrize("noise", [0.1, pytest.param(0.25, marks=nightly)])
def test_noise_does_not_make_a_wrong_hypothesis_win(scan, theta, full_turn, body, noise):
    """What cannot win is ranked by its residual on the same data as what can, the noise not averaged away."""
    found = calibrate(scan(body, full_turn(360), seed=1170, noise=noise))
    rays, _ = errors(found, theta)
    # 2 % noise predicts 0.003 to 0.004 mm here, and the error grows with the noise.
    assert rays < 0.5 * noise
    assert (found.handedness, found.rotation) == (Handedness.AS_DRAWN, Rotation.AS_GIVEN)
    # At 30 % the bound of the second body is 0.102 mm, with what so much noise may hide: too wide for a pass.
    assert found.judgement.verdict == "pass"


@by_night_the_other
def test_counts_are_calibrated_as_well_as_line_integrals(scanner, theta, full_turn, phantom):
    """A detector averages intensities over a cell, not paths: without allowing for it the error is 0.03 to 0.04 mm."""
    wood = phantom.of_density(SAPWOOD_PER_MM).moved(3.0, -2.0)
    made = simulate_stack([wood] * 3, FanBeamGeometry(scanner, theta, full_turn(360)), seed=1180)
    parts = (part.astype(np.float32) for part in (made.counts, made.flats, made.darks))
    sinogram = line_integrals(*parts).stack.mean(axis=1, dtype=np.float64)
    task = CalibrationTask(scanner, phantom, sinogram, full_turn(360), from_counts=True)
    allowed, plain = calibrate(task), calibrate(replace(task, without=frozenset({Adjustment.INTENSITY_AVERAGING})))
    # Photon noise predicts 0.002 mm.
    assert errors(allowed, theta)[0] < 0.01
    assert errors(plain, theta)[0] > 2.0 * errors(allowed, theta)[0]
    assert any("averaging of intensities" in reported for reported in allowed.adjustments)


def test_a_phantom_larger_than_the_detector_is_reported_by_its_size(scanner, full_turn):
    noise = np.random.default_rng(1190).standard_normal((8, 768))
    task = CalibrationTask(scanner, L_SHAPE.scaled(4.0), noise, full_turn(8))
    with pytest.raises(CalibrationError, match=r"and the detector is 1154 mm wide"):
        calibrate(task)
