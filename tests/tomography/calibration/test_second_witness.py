"""The log beside the phantom, in counts with ten flats: agreement, a phantom that slips, a log that slips."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.second_witness import LogAnswer, compare_witnesses
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.calibration.uncertainty_budget import uncertainty_budget
from sawmill_tomography.calibration.with_log import with_log
from sawmill_tomography.drift.change import LogMovement
from sawmill_tomography.geometry.geometry import FanBeamGeometry, Scanner, Theta, to_vector
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM, LogModel
from sawmill_tomography.projection.simulate import simulate_stack
from sawmill_vocabulary import Agreement, DetectorEstimate, MovedBody, Rotation

# Cells of 4.5 mm, in which growth rings are lost, move the u_c of a log on the axis by up to three deviations.
SCANNER = Scanner(source_to_cor_mm=859.46, num_detector_pixels=512, detector_pitch_mm=2.25)
THETA = Theta(0.7, 715.0, 180.0, 30.0, 0.15)
TRUE = THETA.source_frame(SCANNER.source_to_cor_mm)
VIEWS, LOG_ROWS, AT = 180, 8, 90
STILL = LogMovement(0, 0.0, 0.0)


def sinograms(angles, *, phantom_by=(0.0, 0.0), log_by=(0.0, 0.0), seed=0):
    """Line integrals (views, detector) of the phantom and of the log's rows; either slips at view 90."""
    fan = FanBeamGeometry(SCANNER, THETA, angles)
    log = LogModel.random(seed, radius_mm=110.0)
    rows = [L_SHAPE.of_density(SAPWOOD_PER_MM)] + [log.slice_at(130.0 + 6.0 * row) for row in range(LOG_ROWS)]
    slipped = [rows[0].moved(*phantom_by), *(row.moved(*log_by) for row in rows[1:])]
    before = simulate_stack(rows, fan, photons=50_000.0, seed=seed)
    after = before if slipped == rows else simulate_stack(slipped, fan, photons=50_000.0, seed=seed)
    counts = np.concatenate([before.counts[:AT], after.counts[AT:]])
    dark = before.darks.mean(axis=0)
    lines = -np.log(np.maximum(counts - dark, 1.0) / (before.flats.mean(axis=0) - dark))
    return lines[:, 0], lines[:, 1:].mean(axis=1)


def both(angles, **slips):
    """The calibration of the phantom's rows alone, and with the log."""
    phantom, log = sinograms(angles, **slips)
    alone = calibrate(CalibrationTask(SCANNER, L_SHAPE, phantom, angles, from_counts=True))
    return alone, with_log(alone, log)


def off(calibration):
    return ray_error(SCANNER, TRUE, calibration.frame).rms_mm


@pytest.mark.slow
def test_two_that_agree_are_combined(full_turn):
    alone, heard = both(full_turn(VIEWS))
    witness = heard.findings.witness
    assert witness.agreement is Agreement.AGREE
    assert (witness.moved, witness.taken) == (None, "both")
    assert heard.findings.error_bars.predicted_ray_error.rms_mm <= alone.findings.error_bars.predicted_ray_error.rms_mm
    summed = [line for line in uncertainty_budget(heard) if line.counted_in == "sum"]
    rms_mm = heard.findings.error_bars.predicted_ray_error.rms_mm
    assert math.hypot(*(line.rays_mm for line in summed)) == pytest.approx(rms_mm, rel=1e-6)
    assert "log" in {line.source for line in summed}
    # The log adds little to a good phantom; it may not harm it by more than its noise.
    assert off(heard) < off(alone) + 0.003
    assert heard.judgement.verdict == alone.judgement.verdict


@pytest.mark.slow
def test_of_a_phantom_that_slips_the_log_gives_where_the_cor_is(full_turn):
    """A slip by 0.3 mm moves the u_c of a plain fit by 0.24 mm; the log, which stands still, holds it."""
    alone, heard = both(full_turn(VIEWS), phantom_by=(0.3, 0.0))
    assert abs(heard.frame.cor_column_mm - TRUE.cor_column_mm) < 0.06  # three standard deviations of the log's
    # The phantom's own fit finds the slip too; the log need not mend it, and must not spoil it.
    assert any("The phantom moved at view" in reason for reason in heard.judgement.reasons)
    assert off(heard) < off(alone) + 0.003


def test_of_twenty_views_the_log_is_heard_by_pairs_of_them(full_turn):
    alone, heard = both(full_turn(20))
    witness = heard.findings.witness
    assert (witness.agreement, witness.moved, witness.taken) == (Agreement.AGREE, None, "both")
    assert witness.log.movement is None
    # 50 000 photons and 8 rows of 20 views of 256 cells: 0.03 mm, and three standard deviations.
    assert abs(witness.log.detector.cor_column_mm - TRUE.cor_column_mm) < 3.0 * witness.log.detector.deviations[0] < 0.2
    assert heard.findings.error_bars.predicted_ray_error.rms_mm <= alone.findings.error_bars.predicted_ray_error.rms_mm
    assert heard.judgement.verdict == alone.judgement.verdict


@pytest.mark.slow
def test_of_a_log_that_slips_nothing_is_taken(full_turn):
    alone, heard = both(full_turn(VIEWS), log_by=(0.3, 0.2))
    witness = heard.findings.witness
    assert witness.moved is MovedBody.LOG
    assert witness.taken == "phantom"
    assert heard.frame == alone.frame
    assert heard.findings.error_bars.predicted_ray_error == alone.findings.error_bars.predicted_ray_error


@pytest.fixture
def heard():
    """A comparison of a made-up phantom's answer with a log that stood still and gives another u_c."""
    covariance = np.diag([1e-4, 0.2, 0.2, 0.01, 1e-4]) ** 2
    covariance[2, 3] = covariance[3, 2] = 0.5 * 0.2 * 0.01

    def compare(column_mm, movement=STILL, rotation=Rotation.AS_GIVEN, *, phantom_moved=False):
        seen = DetectorEstimate.of(to_vector(TRUE)[[3, 4]] + [column_mm, 0.0], np.diag([0.02, 3e-3]) ** 2)
        log = LogAnswer(seen, np.zeros(2), rotation, movement)
        return compare_witnesses(
            SCANNER, TRUE, covariance, log, Rotation.AS_GIVEN, phantom_moved=phantom_moved, radius_mm=150.0
        )

    return compare


def test_what_the_phantom_gives_follows_by_its_correlation(heard):
    witness = heard(0.02)
    change = witness.vector - to_vector(TRUE)
    assert witness.agreement is Agreement.AGREE
    # Of two with standard deviations 0.01 and 0.02 mm the first has 4/5 of the weight.
    assert change[3] == pytest.approx(0.02 / 5.0, rel=1e-6)
    assert change[2] == pytest.approx(0.5 * 0.2 / 0.01 * change[3], rel=1e-6)
    assert np.sqrt(witness.covariance[3, 3]) == pytest.approx(0.01 * np.sqrt(0.8), rel=1e-6)


def test_between_95_and_999_per_mille_the_errors_are_widened(heard):
    near, strained = heard(0.05), heard(0.07)
    assert (near.agreement, strained.agreement) == (Agreement.AGREE, Agreement.STRAINED)
    assert strained.covariance[3, 3] == pytest.approx(strained.chi_squared / 5.99 * near.covariance[3, 3], rel=1e-6)


def test_beyond_both_error_bars_the_log_that_stood_still_is_right(heard):
    witness = heard(0.24)
    assert (witness.agreement, witness.moved, witness.taken) == (Agreement.DISAGREE, MovedBody.PHANTOM, "log")
    assert witness.vector[3] - TRUE.cor_column_mm == pytest.approx(0.24)
    assert np.sqrt(witness.covariance[3, 3]) == pytest.approx(0.02)
    # SDD was as wrong as u_c: its error is widened by what u_c was off by.
    assert witness.covariance[2, 2] > 0.2**2


def test_a_log_that_jumped_or_turned_the_other_way_is_not_heard(heard):
    jumped = heard(0.24, LogMovement(40, 0.3, 500.0))
    turned = heard(0.0, rotation=Rotation.REVERSED)
    assert jumped.taken == turned.taken == "phantom"
    assert turned.other_sense
    assert np.array_equal(jumped.vector, to_vector(TRUE))


def test_few_views_do_not_tell_which_of_two_moved_unless_the_phantom_was_seen_to(heard):
    undecided, slipped = heard(0.24, None), heard(0.24, None, phantom_moved=True)
    assert (undecided.agreement, undecided.moved, undecided.taken) == (Agreement.DISAGREE, None, "phantom")
    assert np.array_equal(undecided.vector, to_vector(TRUE))
    assert (slipped.moved, slipped.taken) == (MovedBody.PHANTOM, "log")
    assert heard(0.02, None).taken == "both"


def test_r_is_held_where_it_would_be_less_than_the_scanners():
    scanner = replace(SCANNER, source_to_cor_mm=TRUE.source_distance_mm)
    covariance = np.diag([1e-4, 0.2, 0.2, 0.01, 1e-4]) ** 2
    covariance[1, 3] = covariance[3, 1] = -0.9 * 0.2 * 0.01
    seen = DetectorEstimate.of(to_vector(TRUE)[[3, 4]] + [0.01, 0.0], np.diag([0.01, 3e-3]) ** 2)
    log = LogAnswer(seen, np.zeros(2), Rotation.AS_GIVEN, STILL)
    witness = compare_witnesses(scanner, TRUE, covariance, log, Rotation.AS_GIVEN, phantom_moved=False, radius_mm=150.0)
    assert witness.vector[1] == TRUE.source_distance_mm
    # As well known as before, and what holding it moved: both witnesses put R 0.09 mm nearer.
    assert 0.0 < witness.covariance[1, 1] < 0.2**2
