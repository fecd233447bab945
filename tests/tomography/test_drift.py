"""Drift without a phantom: opposite rays of simulated logs, and of the published one."""

import math
from dataclasses import replace

import numpy as np
import pytest
from missing_parts import first_by_day

from sawmill_tomography.drift.change import (
    DetectorFit,
    Disturbance,
    DriftError,
    disturbed_turn,
    drift_change,
    likely_cause,
)
from sawmill_tomography.drift.opposite_rays.conjugate_rays import conjugate_fit
from sawmill_tomography.drift.opposite_rays.paired_rays import Derivatives, PairedRays
from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, Scanner, Theta
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.projection.analytic import DetectorCells, project
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_vocabulary import Rotation

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("one_thread")]

MILL = Scanner(source_to_cor_mm=859.46, num_detector_pixels=384, detector_pitch_mm=3.0)
THETA = Theta(0.7, 715.0, 180.0, 30.0, 0.15)
# The seed of a log whose slice does not meet the metal that every simulated log has.
WITHOUT_METAL = 9


def log(seed: int) -> Phantom:
    rng = np.random.default_rng(seed)
    model = LogModel.random(seed, radius_mm=rng.uniform(100, 140))
    return model.slice_at(rng.uniform(50, 350)).moved(*rng.uniform(-8, 8, 2))


def scan(angles, *, theta=THETA, seed=1, noise=0.01, body=None):
    return simulate_sinogram(body or log(seed), FanBeamGeometry(MILL, theta, angles), noise=noise, seed=seed)


def detector(frame) -> np.ndarray:
    return np.array([frame.cor_column_mm, frame.tilt_rad, frame.source_to_detector_mm])


def moved(frame, column=0.0, tilt=0.0, distance=0.0):
    return replace(
        frame,
        cor_column_mm=frame.cor_column_mm + column,
        tilt_rad=frame.tilt_rad + tilt,
        source_to_detector_mm=frame.source_to_detector_mm + distance,
    )


@pytest.fixture(scope="module")
def frame():
    return THETA.source_frame(MILL.source_to_cor_mm)


@pytest.mark.parametrize("off", [(0.0, 0.0, 0.0), (8.0, 0.02, 20.0), (-20.0, 0.0, -10.0)])
@pytest.mark.parametrize("sense", list(Rotation))
def test_the_published_log_shows_its_centre_to_a_twentieth_of_a_millimetre(
    scanner, theta, full_turn, log_sinogram, off, sense
):
    truth = theta.source_frame(scanner.source_to_cor_mm)
    fit = conjugate_fit(scanner, log_sinogram, sense.apply(full_turn(360)), moved(truth, *off))
    error = detector(fit) - detector(truth)
    assert abs(error[0]) < 0.05
    assert abs(math.degrees(error[1])) < 0.05
    assert np.all(np.abs(error) < 3.0 * fit.deviation)
    assert fit.rotation is sense
    assert fit.rotation_ratio > 10.0


def test_the_error_bars_are_honest(full_turn):
    rng = np.random.default_rng(41)
    shares = []
    for seed in range(40, 56):
        theta = Theta(*rng.uniform([0, 600, -250, -60, -0.3], [6.28, 850, 250, 60, 0.3]))
        truth = theta.source_frame(MILL.source_to_cor_mm)
        sinogram = scan(full_turn(180), theta=theta, seed=seed)
        fit = conjugate_fit(MILL, sinogram, full_turn(180), moved(truth, 0.6, 0.002, 5.0))
        shares.append((detector(fit) - detector(truth)) / fit.deviation)
    # Of 16 standard normal numbers the RMS lies within these in 99.7 % of draws.
    assert np.all(np.abs(np.sqrt(np.mean(np.square(shares), axis=0)) - 1.0) < 0.53)


def test_an_exactly_centred_log_is_answered_honestly(full_turn):
    rng = np.random.default_rng(6)
    shares = []
    for seed in range(8):
        theta = Theta(*rng.uniform([0, 600, -250, -60, -0.3], [6.28, 850, 250, 60, 0.3]))
        truth = theta.source_frame(MILL.source_to_cor_mm)
        body = LogModel.random(seed, radius_mm=120.0).slice_at(75.0)
        fit = conjugate_fit(MILL, scan(full_turn(180), theta=theta, body=body, seed=seed), full_turn(180), truth)
        shares.append((fit.cor_column_mm - truth.cor_column_mm) / fit.deviation[0])
    # The RMS of so few standard normal numbers stays within these in 99.5 % of draws.
    assert 0.3 < math.sqrt(np.mean(np.square(shares))) < 1.9


@pytest.fixture(scope="module")
def plain(full_turn):
    """A noisy scan of which only one thing is made wrong at a time: of a log without metal."""
    return scan(full_turn(180), seed=WITHOUT_METAL)


def spoil(plain, how):
    match how:
        case "faulty cells":
            plain[:, 150], plain[:, 231] = 0.0, 1.4 * plain.max()
            plain[:, 230] = 30.0 * np.random.default_rng(3).random(180)
        case "corrupt views":
            plain[40], plain[90], plain[120, :200] = 30.0, 0.0, -50.0
        case "views of another angle":
            plain[[20, 60, 61]] = plain[[10, 75, 76]]
        case "gains of each view":
            plain *= 1.0 + 0.02 * np.random.default_rng(7).standard_normal((180, 1))


@pytest.mark.parametrize("sense", list(Rotation))
@pytest.mark.parametrize(
    ("how", "remark"),
    [
        (None, None),
        ("faulty cells", "detector cells without a usable signal"),
        ("corrupt views", "3 corrupt views"),
        ("views of another angle", "3 views whose rays do not agree"),
        ("gains of each view", "gain scattered by"),
    ],
)
def test_what_is_wrong_with_a_scan_is_left_out_or_evened_out_and_named(plain, full_turn, frame, sense, how, remark):
    sinogram = plain.copy()
    spoil(sinogram, how)
    fit = conjugate_fit(MILL, sinogram, sense.apply(full_turn(180)), moved(frame, 0.6, 0.002))
    assert np.all(np.abs(detector(fit) - detector(frame)) < 4.0 * fit.deviation)
    assert fit.deviation[0] < 0.15  # a clean scan of this log gives 0.05 mm
    assert fit.relative_residual < 0.15
    assert [remark in done for done in fit.adjustments] == ([True] if remark else [])


def disturbed(angles, *, encoder_deg=0.0, wobble_mm=0.0, body=None, seed=WITHOUT_METAL):
    """A scan whose angles run ahead and behind, and whose log swings across the beam twice a turn."""
    true = angles + np.deg2rad(encoder_deg) * np.cos(angles - 0.4)
    fan = FanBeamGeometry(MILL, THETA, true)
    across = true + fan.frame.psi_rad
    swing = wobble_mm * np.cos(2.0 * angles - 0.7)
    cells = DetectorCells.of(MILL)
    clean = np.concatenate(
        [
            project(body or log(seed), cells, fan.frame, true[k : k + 1], position_mm=(s * np.cos(e), s * np.sin(e)))
            for k, (s, e) in enumerate(zip(swing, across, strict=True))
        ]
    )
    return clean + 0.005 * np.sqrt(np.mean(clean**2)) * np.random.default_rng(seed).standard_normal(clean.shape)


@pytest.mark.parametrize("sense", list(Rotation))
@pytest.mark.parametrize(
    ("disturbance", "part", "order"),
    [({"encoder_deg": 0.3}, "encoder", 1), ({"wobble_mm": 1.0}, "bearing", 2), ({"wobble_mm": 0.03}, "bearing", 2)],
)
def test_a_disturbed_turn_is_no_drift(full_turn, frame, sense, disturbance, part, order):
    sinogram = disturbed(full_turn(180), **disturbance)
    fit = conjugate_fit(MILL, sinogram, sense.apply(full_turn(180)), moved(frame, 0.6, 0.002), sense)
    size = fit.disturbances[Disturbance(part, order)]
    # Cells of 3 mm blur the rings that show it, and the fit is linear in the disturbance.
    assert size == pytest.approx(*disturbance.values(), rel=0.25)
    assert np.all(np.abs(detector(fit) - detector(frame)) < 4.0 * fit.deviation)
    (reason,) = disturbed_turn(fit)
    assert {"encoder": "look at the encoder", "bearing": "look at the turntable's bearing"}[part] in reason
    assert not drift_change(MILL, frame, np.diag([1e-8, 0.04, 0.25, 4e-4, 1e-7]), fit).moved


def test_a_steady_turn_is_not_called_disturbed(plain, full_turn, frame):
    fit = conjugate_fit(MILL, plain, full_turn(180), frame)
    assert not fit.disturbances
    assert disturbed_turn(fit) == ()


@pytest.mark.parametrize("sense", first_by_day(1, Rotation))
def test_rays_through_nails_are_left_out(full_turn, frame, sense):
    """Nails starve their rays: cut off at a line integral of 6, they are no longer the same from either side."""
    nails = (Disc((70.0, 20.0), 4.0, 1.0), Disc((-40.0, -60.0), 5.0, 1.0), Disc((10.0, 85.0), 3.0, 1.0))
    body = log(WITHOUT_METAL)
    sinogram = np.minimum(disturbed(full_turn(120), body=Phantom("nailed", (*body.shapes, *nails))), 6.0)
    fit = conjugate_fit(MILL, sinogram, sense.apply(full_turn(120)), moved(frame, 0.6, 0.002), sense)
    assert np.all(np.abs(detector(fit) - detector(frame)) < 4.0 * fit.deviation)
    assert fit.deviation[0] < 0.15
    assert not fit.disturbances
    (remark,) = fit.adjustments
    assert "metal in the log" in remark


def test_without_noise_the_geometry_is_found_whatever_r_and_psi_are(full_turn, frame):
    sinogram = scan(full_turn(180), noise=0.0)
    fit = conjugate_fit(MILL, sinogram, full_turn(180), moved(frame, -3.0, 0.01, 10.0))
    assert np.all(np.abs(detector(fit) - detector(frame)) < [0.01, 2e-4, 1.0])
    assert fit.relative_residual < 0.02
    other = replace(moved(frame, -3.0, 0.01, 10.0), source_distance_mm=500.0, psi_rad=3.0)
    assert np.array_equal(detector(conjugate_fit(MILL, sinogram, full_turn(180), other)), detector(fit))


def test_what_every_view_has_in_common_is_no_drift(full_turn, frame):
    sinogram = scan(full_turn(180))
    rings = sinogram + 0.3 * np.random.default_rng(3).standard_normal(MILL.num_detector_pixels)
    plain, ringed = (conjugate_fit(MILL, each, full_turn(180), frame) for each in (sinogram, rings))
    assert np.allclose(detector(ringed), detector(plain), rtol=0, atol=1e-6)


def test_irregular_views_in_any_order_do(frame):
    rng = np.random.default_rng(5)
    angles = rng.permutation((np.arange(240) + rng.uniform(-0.3, 0.3, 240)) * 2.0 * np.pi / 240)
    fit = conjugate_fit(MILL, scan(angles), angles, moved(frame, 1.0))
    assert abs(fit.cor_column_mm - frame.cor_column_mm) < min(0.2, 4.0 * fit.deviation[0])


@pytest.mark.parametrize(
    ("angles", "code", "sentence"),
    [
        (np.arange(60) * 2.0 * np.pi / 60, "sparse-views", "60 views stand 6 degrees apart"),
        (np.deg2rad(np.arange(270.0)), "partial-turn", "a gap of 91 degrees where their usual distance is 1"),
        (np.deg2rad(np.delete(np.arange(360.0), [40, 41, 42])), "partial-turn", "a gap of 4 degrees"),
    ],
)
def test_sparse_and_partial_turns_are_refused(frame, angles, code, sentence):
    with pytest.raises(DriftError, match=sentence) as refusal:
        conjugate_fit(MILL, np.ones((angles.size, MILL.num_detector_pixels)), angles, frame)
    assert refusal.value.code == code


ROUND = Phantom("round", (Disc((0.0, 0.0), 120.0, 0.02),))


@pytest.mark.parametrize(
    ("body", "off_mm", "codes"),
    [
        (None, 0.0, {"nothing-seen"}),
        (ROUND, 0.0, {"nothing-seen"}),
        (log(1), 90.0, {"moved-too-far", "nothing-seen"}),
        (log(1), 600.0, {"outside-detector"}),
    ],
    ids=["no log", "a round log", "moved too far", "beyond the detector"],
)
def test_what_shows_no_centre_is_refused(full_turn, frame, body, off_mm, codes):
    sinogram = np.zeros((180, 384)) if body is None else scan(full_turn(180), body=body, noise=0.02)
    with pytest.raises(DriftError) as refusal:
        conjugate_fit(MILL, sinogram, full_turn(180), moved(frame, off_mm))
    assert refusal.value.code in codes


def test_a_log_that_hardly_shows_the_distance_leaves_it_as_calibrated(full_turn, frame):
    # Outlines that are no circles show the distance.
    body = replace(LogModel.random(WITHOUT_METAL), waves=((0j,) * 5,) * 5).slice_at(20.0)
    fit = conjugate_fit(MILL, scan(full_turn(180), body=body, noise=0.01), full_turn(180), moved(frame, 0.5))
    assert fit.distance_held
    assert fit.source_to_detector_mm == frame.source_to_detector_mm
    assert abs(fit.cor_column_mm - frame.cor_column_mm) < 4.0 * fit.deviation[0]
    uncertain = drift_change(MILL, frame, np.diag([0.0, 0.0, 100.0, 0.0, 0.0]), fit)
    off = conjugate_fit(MILL, scan(full_turn(180), body=body, noise=0.01), full_turn(180), moved(frame, distance=10.0))
    distance_sensitivity = [off.cor_column_mm - fit.cor_column_mm, off.tilt_rad - fit.tilt_rad]
    # The slopes are those of noisy data.
    assert 10.0 * fit.distance_sensitivity == pytest.approx(distance_sensitivity, rel=0.4)
    assert uncertain.deviation[:2] == pytest.approx(np.hypot(fit.deviation[:2], 10.0 * fit.distance_sensitivity))
    change = drift_change(MILL, frame, np.eye(5) * 1e-8, fit)
    assert change.deviation[2] == change.significance[2] == change.change[2] == 0.0
    assert "Nothing moved" in likely_cause(frame, change)


def turntable(theta: Theta, by_mm: float) -> Theta:
    """The turntable moves along x: seen from it, source and detector move the other way."""
    return replace(
        theta, source_shift_mm=theta.source_shift_mm - by_mm, detector_shift_mm=theta.detector_shift_mm + by_mm
    )


def slid(theta: Theta, by_mm: float) -> Theta:
    """The detector slides along its axis a."""
    step = by_mm / math.hypot(1.0, theta.detector_tilt)
    return replace(
        theta,
        detector_shift_mm=theta.detector_shift_mm - step,
        detector_to_cor_mm=theta.detector_to_cor_mm + step * theta.detector_tilt,
    )


def turned(theta: Theta, by: float) -> Theta:
    return replace(theta, detector_tilt=theta.detector_tilt + by)


@pytest.mark.parametrize(
    ("now", "noise", "within", "cause"),
    [
        (THETA, 0.002, True, "Nothing moved that this scan can show"),
        (turntable(THETA, 0.5), 0.02, True, "Look at the turntable and at the detector's stops"),
        (turntable(THETA, 20.0), 0.002, False, "the tilt followed as when the turntable moves sideways"),
        (slid(THETA, 20.0), 0.002, False, "Look at the detector's stops"),
        (turned(THETA, 0.04), 0.002, False, "Look at the mounting of detector and source"),
    ],
)
def test_what_moved_is_named(full_turn, frame, now, noise, within, cause):
    fit = conjugate_fit(MILL, scan(full_turn(360), theta=now, seed=8, noise=noise), full_turn(360), frame)
    change = drift_change(MILL, frame, None, fit)
    truth = detector(now.source_frame(MILL.source_to_cor_mm)) - detector(frame)
    assert np.all(np.abs(change.change - truth) < 4.0 * change.deviation)
    assert cause in likely_cause(frame, change)
    assert (change.ray_change_mm < 0.5) == within
    if change.moved:
        assert f"{change.change[0]:+.2f} mm" in likely_cause(frame, change)


def test_a_detector_that_moved_along_the_beam_changes_the_scale(full_turn, frame):
    """The shape of the rays hardly shows it, the size of the image does: with R held it goes as 1 / SDD."""
    farther = replace(frame, source_to_detector_mm=frame.source_to_detector_mm + 30.0)
    fit = conjugate_fit(MILL, scan(full_turn(360), seed=8, noise=0.002), full_turn(360), frame)
    change = drift_change(MILL, frame, None, replace(fit, source_to_detector_mm=farther.source_to_detector_mm))
    assert change.ray_change_mm < 0.5
    # The rest of the change is one of shape.
    assert change.scale_change == pytest.approx(
        frame.source_to_detector_mm / farther.source_to_detector_mm - 1, rel=0.1
    )
    assert 1.96 * change.scale_deviation < abs(change.scale_change)


def test_the_calibration_s_own_errors_count(full_turn, frame):
    fit = conjugate_fit(MILL, scan(full_turn(180)), full_turn(180), frame)
    calibrated = moved(frame, 1.0)
    surely = drift_change(MILL, calibrated, None, fit)
    perhaps = drift_change(MILL, calibrated, np.diag([1e-4, 1.0, 4.0, 1.0, 1e-4]), fit)
    assert surely.moved
    assert not perhaps.moved
    assert perhaps.deviation**2 == pytest.approx(surely.deviation**2 + [1.0, 1e-4, 4.0])


def test_an_error_that_u_c_and_the_held_distance_share_cancels(full_turn, frame):
    """A calibration that is wrong by 2 mm of SDD, and by what this does to u_c and tau, measures no drift."""
    fit = conjugate_fit(MILL, scan(full_turn(180)), full_turn(180), frame)
    slope = np.array([0.4, -0.003])
    held = replace(fit, distance_held=True, distance_sensitivity=slope)
    error = 2.0 * np.array([0.0, 0.0, 1.0, *slope])
    shared, opposite = (
        drift_change(MILL, frame, np.outer(signs * error, signs * error), held).deviation ** 2
        for signs in (np.ones(5), np.array([1.0, 1.0, -1.0, 1.0, 1.0]))
    )
    np.testing.assert_allclose(shared[:2], fit.deviation[:2] ** 2, rtol=1e-6)
    np.testing.assert_allclose(opposite[:2], fit.deviation[:2] ** 2 + (4.0 * slope) ** 2, rtol=1e-6)


def test_a_distance_that_has_not_surely_changed_is_held(full_turn, frame):
    fit = conjugate_fit(MILL, scan(full_turn(180)), full_turn(180), frame)
    assert not fit.distance_held
    assert not fit.distance_sensitivity.any()
    worse = replace(fit, covariance=fit.covariance + np.diag([0.0, 0.0, 400.0]), source_to_detector_mm=1650.0)
    assert abs(worse.source_to_detector_mm - frame.source_to_detector_mm) > 20.0
    assert drift_change(MILL, frame, None, worse).ray_change_mm < 0.2


def test_pairs_that_no_longer_show_the_unknowns_have_no_error_bars():
    """Under a mask the normal matrix is not symmetric: definite below its diagonal, and not as a whole."""
    slopes = np.array([[[1.0, 0.0]], [[3.0, 1.0]]])
    derivatives = Derivatives(slopes, np.array([[[1.0, 0.0]], [[0.0, 1.0]]]), *[np.zeros_like(slopes)] * 2)
    rays = PairedRays(np.ones((1, 2)), derivatives, np.eye(2)[:, :, None], np.ones((1, 2), bool))
    assert np.isinf(rays.covariance(slice(0, 2), corrected=True)).all()


def test_differences_that_change_slowly_count_as_correlated():
    """Of scatter on a measured scan: the distance scattered by twice what independent differences would make of it."""
    views, fits, stated = 120, [], {0.0: [], 1 / 12: []}
    chi = np.arange(views) * TAU / views
    nothing = np.zeros((1, 1, views))
    for seed in range(200):
        rng = np.random.default_rng(seed)
        slope = (2.0 + np.cos(chi - rng.uniform(0.0, TAU)))[None, None, :]
        smooth = np.exp(-0.5 * ((np.arange(views) - 0.5 * views) / 3.0) ** 2)
        slow = np.real(np.fft.ifft(np.fft.fft(rng.standard_normal(views)) * np.fft.fft(smooth)))
        derivatives = Derivatives(slope, slope, nothing, nothing)
        rays = PairedRays(slow[None], derivatives, np.ones((1, 1, 1)), np.ones((1, views), bool))
        fits.append(float(rays.scores.sum() / rays.gram(corrected=True)[0, 0]))
        for share, deviations in stated.items():
            deviations.append(math.sqrt(rays.covariance(slice(0, 1), corrected=True, correlated=share)[0, 0]))
    alone, together = (np.std(fits) / np.sqrt(np.mean(np.square(each))) for each in stated.values())
    # Of 200 the standard deviation is known to 5 %; Bartlett's weights leave some of the correlation out.
    assert alone > 2.0
    assert together == pytest.approx(1.1, abs=0.2)


def test_a_known_distance_removes_its_part_of_the_errors():
    """The errors of what remains are those of a normal distribution whose third value is known."""
    root = np.random.default_rng(1).standard_normal((3, 3))
    covariance = root @ root.T
    about = (Rotation.AS_GIVEN, 1.0, True, 0.01, np.zeros(2), ())
    known = DetectorFit(-209.0, -0.08, 1620.0, covariance, False, *about).at_distance(1623.0)
    np.testing.assert_allclose(known.covariance, np.linalg.inv(np.linalg.inv(covariance)[:2, :2]), rtol=1e-9)
    expected = [-209.0, -0.08] + 3.0 * covariance[:2, 2] / covariance[2, 2]
    np.testing.assert_allclose([known.cor_column_mm, known.tilt_rad], expected)
