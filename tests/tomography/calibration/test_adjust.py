"""What real scans are beyond the plain model: each fault alone, on a scan that fails without its remedy."""

from dataclasses import replace

import numpy as np
import pytest
from missing_parts import first_by_day
from scipy.ndimage import gaussian_filter1d

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.refusals import CalibrationError
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import Scanner, SourceFrame, Theta
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_tomography.sinograms.screening import Screening, screen
from sawmill_vocabulary import Adjustment, Handedness, Rotation

pytestmark = pytest.mark.slow

SCANNER = Scanner(859.46, 768, 1.502864583)
FRAME = Theta(1.2, 741.0, 212.0, 31.0, 0.17).source_frame(859.46)
POSITION = (4.0, -7.0)
VIEWS = 60
# 1 % noise and 60 views predict 0.004 mm; a remedy that works leaves no more than a few times that.
LIMIT_MM = 0.015


@pytest.fixture(scope="module")
def angles():
    return (np.arange(VIEWS) + 0.5) * 2.0 * np.pi / VIEWS


@pytest.fixture(scope="module")
def clean(angles):
    return analytic.project(L_SHAPE, DetectorCells.of(SCANNER), FRAME, angles, position_mm=POSITION, rays_per_cell=6)


@pytest.fixture(scope="module")
def moments(angles):
    rows = analytic.project(L_SHAPE, DetectorCells.of(SCANNER), FRAME, angles, position_mm=POSITION, derivatives=True)
    return rows[8:10]


def noise_on(sinogram, clean, seed):
    spread = 0.01 * np.sqrt(np.mean(clean**2))
    return sinogram + spread * np.random.default_rng(seed).standard_normal(sinogram.shape)


def off_mm(sinogram, angles, *without):
    found = calibrate(CalibrationTask(SCANNER, L_SHAPE, sinogram, angles, without=frozenset(without)))
    return ray_error(SCANNER, FRAME, found.frame).rms_mm, found


def hot_cells(clean, *, moments=None, rng=None):  # noqa: ARG001 - every fault is given the same
    clean[:, rng.choice(768, 8, replace=False)] += 200.0


def dead_cells(clean, *, moments=None, rng=None):  # noqa: ARG001 - every fault is given the same
    clean[:, rng.choice(np.arange(200, 500), 8, replace=False)] = 0.0


def a_band_without_data(clean, *, moments=None, rng=None):  # noqa: ARG001 - every fault is given the same
    clean[:, 300:330] = 0.0


def corrupt_views(clean, *, moments=None, rng=None):  # noqa: ARG001 - every fault is given the same
    clean[rng.choice(VIEWS, 3, replace=False)] = 100.0 * rng.standard_normal((3, 768))


def gain_of_each_view(clean, *, moments=None, rng=None):  # noqa: ARG001 - every fault is given the same
    clean *= 1.0 + 0.05 * rng.standard_normal((VIEWS, 1))


def background_of_each_view(clean, *, moments=None, rng=None):  # noqa: ARG001 - every fault is given the same
    clean += 10.0 * rng.standard_normal((VIEWS, 1))


def beam_hardening(clean, *, moments=None, rng=None):  # noqa: ARG001 - every fault is given the same
    clean -= 2.5e-4 * clean**2


def sloping_density(clean, *, moments=None, rng=None):  # noqa: ARG001 - every fault is given the same
    clean += 0.001 * moments[0] - 0.0007 * moments[1]


def blur(clean, *, moments=None, rng=None):  # noqa: ARG001 - every fault is given the same
    clean[:] = gaussian_filter1d(clean, 2.0, axis=1, mode="nearest")


def a_glitch_in_three_views(clean, *, moments=None, rng=None):  # noqa: ARG001 - every fault is given the same
    clean[rng.choice(VIEWS, 3, replace=False), 300:520] += 0.06 * clean.max()


def displaced_views(clean, *, moments=None, rng=None):  # noqa: ARG001 - every fault is given the same
    views = rng.choice(VIEWS, 3, replace=False)
    clean[views] = np.roll(clean[views], 5, axis=1)


OF_CELLS = [Adjustment.FAULTY_CELLS, Adjustment.OUTLIERS]
# The fault, how it is reported, and what must be left out for the scan to fail: outliers would mend single cells too,
# and densities of the wood's patches what rays through much wood have in common.
FAULTS = {
    "hot cells": (hot_cells, "detector cells without a usable signal", OF_CELLS),
    "dead cells": (dead_cells, "detector cells without a usable signal", OF_CELLS),
    "a band without data": (a_band_without_data, "30 detector cells without a usable", [Adjustment.FAULTY_CELLS]),
    "corrupt views": (corrupt_views, "3 corrupt views", [Adjustment.CORRUPT_VIEWS]),
    "a glitch in three views": (a_glitch_in_three_views, "of the samples are outliers", [Adjustment.OUTLIERS]),
    "displaced views": (displaced_views, "3 views that do not fit the others", [Adjustment.OUTLIERS]),
    "gain of each view": (gain_of_each_view, "The views differ in gain", [Adjustment.VIEW_GAIN]),
    "background of each view": (background_of_each_view, "The views differ in gain", [Adjustment.VIEW_GAIN]),
    "beam hardening": (beam_hardening, "Beam hardening of -8", [Adjustment.BEAM_HARDENING, Adjustment.WOOD_DENSITY]),
    "slope": (sloping_density, "slopes by 12", [Adjustment.DENSITY_GRADIENT, Adjustment.WOOD_DENSITY]),
    "blur": (blur, "A blur of 2.0", [Adjustment.BLUR]),
}


# How much worse the rays or their bound are without the remedy. Cells that stand out in every view have little weight
# in any case, and noise weighs what a blur spoils most, the edges, least.
WORSE = {"hot cells": 1.0, "blur": 1.5}


@pytest.mark.parametrize("name", FAULTS)
@pytest.mark.parametrize("switched_off", first_by_day(1, [False, True]), ids=["mended", "left alone"])
def test_a_fault_is_found_reported_and_mended_unless_its_remedy_is_switched_off(
    clean, moments, angles, name, switched_off
):
    fault, reported, remedies = FAULTS[name]
    faulty = clean.copy()
    fault(faulty, moments=moments, rng=np.random.default_rng(1200))
    faulty = noise_on(faulty, clean, 1201)
    if name == "a band without data":
        faulty[:, 300:330] = 0.0
    error, found = off_mm(faulty, angles)
    assert error < LIMIT_MM
    assert any(reported in sentence for sentence in found.adjustments)
    assert (found.judgement.status, found.judgement.verdict) == ("calibrated", "pass")
    if not switched_off:
        return
    try:
        plain, left_alone = off_mm(faulty, angles, *remedies)
    except CalibrationError:
        return  # without its remedy the phantom is not even found
    bound, left_bound = (each.findings.error_bars.predicted_ray_error.upper_95_mm for each in (found, left_alone))
    assert max(plain / error, left_bound / bound) > WORSE.get(name, 4.0)
    assert not any(reported in sentence for sentence in left_alone.adjustments)
    # What is not mended is not passed over: it is named, and where the answer passes nevertheless, the pass is right.
    assert left_alone.judgement.reasons
    assert left_alone.judgement.verdict != "pass" or plain < left_alone.task.tolerance_mm


def test_blur_widens_the_residual_and_its_model_brings_noise_back(clean, angles):
    soft = clean.copy()
    blur(soft)
    measured = noise_on(soft, clean, 1230)
    _, sharp = off_mm(measured, angles, *Adjustment)
    _, found = off_mm(measured, angles)
    spread = 0.01 * np.sqrt(np.mean(clean**2))
    assert sharp.findings.fit.residual_rms > 1.2 * spread
    assert sharp.findings.error_bars.statistics.inflation > 5.0
    # A dozen terms are fitted to 46 080 samples.
    assert found.findings.fit.residual_rms == pytest.approx(spread, rel=0.03)
    assert found.findings.error_bars.statistics.inflation < 1.5
    predicted, without = (each.findings.error_bars.predicted_ray_error for each in (found, sharp))
    assert predicted.rms_mm < 0.2 * without.rms_mm
    assert any("at the phantom's edges" in reason for reason in sharp.judgement.reasons)


def test_blur_and_hardening_are_distinguished(clean, angles):
    both = clean.copy()
    beam_hardening(both)
    blur(both)
    error, found = off_mm(noise_on(both, clean, 1231), angles)
    assert error < LIMIT_MM
    assert len(found.adjustments) == 2


def test_with_everything_switched_off_nothing_is_done(clean, angles):
    faulty = clean.copy()
    beam_hardening(faulty)
    _, found = off_mm(noise_on(faulty, clean, 1232), angles, *Adjustment)
    assert found.adjustments == ()


@pytest.mark.parametrize("seed", first_by_day(1, range(1210, 1213)))
def test_nothing_is_done_where_nothing_is_wrong(clean, angles, seed):
    error, found = off_mm(noise_on(clean, clean, seed), angles)
    assert error < LIMIT_MM
    assert found.adjustments == ()


def test_the_measured_less_the_model_is_the_noise(clean, angles):
    faulty = clean.copy()
    beam_hardening(faulty)
    _, found = off_mm(noise_on(faulty, clean, 1220), angles)
    spread = 0.01 * np.sqrt(np.mean(clean**2))
    # A dozen terms are fitted to 46 080 samples; cells at edges carry the rest.
    assert np.std(found.residual) == pytest.approx(spread, rel=0.03)


def test_bridging_is_linear_between_neighbours():
    row = np.arange(20.0) * np.ones((3, 1))
    usable = np.ones(20, bool)
    usable[[0, 7, 8, 19]] = False
    bridged = Screening(usable, np.ones(3, bool)).bridged(np.where(usable, row, 99.0))
    np.testing.assert_allclose(bridged[:, 1:19], row[:, 1:19])
    np.testing.assert_allclose(bridged[:, [0, 19]], [[1.0, 18.0]] * 3)


def test_an_empty_detector_is_left_as_it_is():
    assert screen(np.zeros((5, 30))).weights is None


def test_a_view_left_out_leaves_numbers_where_every_view_has_a_gain(clean, angles):
    rng = np.random.default_rng(1210)
    faulty = clean.copy()
    gain_of_each_view(faulty, rng=rng)
    faulty[11] = 100.0 * rng.standard_normal(768)
    _, found = off_mm(noise_on(faulty, clean, 1211), angles)
    assert any("gain or background" in sentence for sentence in found.adjustments)
    assert np.isfinite(found.residual).all()


# A scanner of a laboratory, and a body that is nearly round.
LABORATORY = SourceFrame(0.3, 410.66, 553.74, -0.05, 0.003)
NEARLY_ROUND = Phantom("disc with holes", (Disc((0, 0), 35.0), Disc((15, 3), 5.0, -1.0), Disc((-5, -20), 4.0, -1.0)))


def of_the_disc(views, cells, *, body=NEARLY_ROUND, position=(0.3, -0.2)):
    """A task with an exact scan of the disc, as drawn and as given."""
    scanner, angles = Scanner(410.66, cells, 112.0 / cells), np.arange(views) * 2.0 * np.pi / views
    clean = analytic.project(body, DetectorCells.of(scanner), LABORATORY, angles, position_mm=position)
    known = {"handedness": Handedness.AS_DRAWN, "rotation": Rotation.AS_GIVEN}
    return CalibrationTask(scanner, NEARLY_ROUND, clean, angles, **known)


def assert_bounds_hold(found):
    off = ray_error(found.scanner, LABORATORY, found.frame, radius_mm=found.radius_mm)
    assert off.rms_mm < found.findings.error_bars.predicted_ray_error.upper_95_mm
    assert 100.0 * abs(off.scale_change) < found.findings.scale.percent_95


@pytest.mark.parametrize(("square", "percent"), [(0.002, 14.0), (0.003, 21.0)], ids=["a little", "much"])
def test_hardening_that_is_alike_in_many_views_is_found(square, percent):
    """A round body in the middle hardens all views alike, as stripes of the flat field look.

    1 % noise and 90 views predict 0.004 mm. With the hardening left in, the rays are 0.06 mm off, or R twice as long.
    """
    task, rng = of_the_disc(90, 140), np.random.default_rng(2)
    scan = task.sinogram - square * task.sinogram**2
    scan += 0.002 * scan.std() * rng.standard_normal(140) + 0.01 * scan.std() * rng.standard_normal(scan.shape)
    found = calibrate(replace(task, sinogram=scan))
    (named,) = (sentence for sentence in found.adjustments if sentence.startswith("Beam hardening"))
    # Gains of each view and the cubic term take up to 1 % of it.
    assert float(named.split("-")[1].split("%")[0]) == pytest.approx(percent, abs=1.0)
    assert found.judgement.rays_verdict == "pass"
    assert_bounds_hold(found)


def displaced_along_the_beam(views):
    """Positions (views, 2) of a turntable that moves by 0.4 mm along the beam, twice a turn."""
    angles = np.arange(views) * 2.0 * np.pi / views
    phi = angles + LABORATORY.psi_rad
    return 0.4 * np.cos(2.0 * angles + 0.5)[:, None] * np.stack([-np.sin(phi), np.cos(phi)], -1)


# A body 0.2 % longer in one direction than drawn, and one that comes nearer to the source twice a turn.
READINGS = {
    "longer": {"body": NEARLY_ROUND.deformed(0.0015, 0.0013)},
    "wobbling": {"position": displaced_along_the_beam(20)},
}


@pytest.mark.parametrize("truth", READINGS)
def test_the_bounds_hold_where_a_scan_does_not_tell_a_wobble_from_a_longer_outline(truth):
    """2 % noise and 20 views, with gains of their own: the outline has fewer unknowns, and is named for both."""
    task, rng = of_the_disc(20, 280, **READINGS[truth]), np.random.default_rng(2)
    scan = task.sinogram * (1.0 + 0.01 * rng.standard_normal((20, 1)))
    scan += 0.02 * scan.std() * rng.standard_normal(scan.shape)
    found = calibrate(replace(task, sinogram=scan))
    assert any(sentence.startswith("The phantom is longer in x than in y") for sentence in found.adjustments)
    assert found.findings.scale.aspect_half > 0.0
    assert_bounds_hold(found)


@pytest.mark.nightly
@pytest.mark.xfail(reason="0.5 % of the samples, at edges, are taken for outliers too", strict=True)
@pytest.mark.parametrize(("truth", "other"), [("longer", "wobbles"), ("wobbling", "longer")])
def test_a_wobble_and_a_longer_outline_are_told_apart_by_a_scan_with_little_noise(truth, other):
    task, rng = of_the_disc(20, 280, **READINGS[truth]), np.random.default_rng(2)
    noise = 0.005 * task.sinogram.std() * rng.standard_normal((20, 280))
    found = calibrate(replace(task, sinogram=task.sinogram + noise))
    assert len(found.adjustments) == 1
    assert other not in found.adjustments[0]
    assert_bounds_hold(found)
