"""Rows that nobody named are found."""

import numpy as np
import pytest

from sawmill_calibration.calibration.calibrate import (
    CalibrationInput,
    _in_phantom_rows,
    calibration_result,
    run_calibration,
)
from sawmill_calibration.calibration.second_witness import with_second_witness, witness_of
from sawmill_command.examples import PHANTOM_ROWS, SCANNER, THETA, full_turn, mill_slices, mill_stack
from sawmill_contracts.calibrations import CalibrationOptions
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.phantoms import BUILT_IN_PHANTOMS
from sawmill_tomography.calibration.errors import CalibrationError
from sawmill_tomography.geometry.geometry import to_vector
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.preparing.line_integrals import line_integrals

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def stack():
    made = mill_stack(60, mill_slices())
    counts, flats, darks = (part.astype(np.float32) for part in (made.counts, made.flats, made.darks))
    return line_integrals(counts, flats, darks).stack


def given(stack):
    return CalibrationInput(
        sinogram=stack.mean(axis=1, dtype=np.float64),
        angles_rad=full_turn(60),
        rows=(0, stack.shape[1]),
        scanner=ScannerConstants(**vars(SCANNER)),
        bounds=None,
        drawing=BUILT_IN_PHANTOMS["l-shape"],
        input_sha256="0" * 64,
    )


@pytest.fixture(scope="module")
def calibrated(stack):
    """With rows that nobody named: the input of those that were found, the calibration, and what was reported."""
    progress = []
    return *run_calibration(given(stack), CalibrationOptions(), progress.append, stack=stack), progress


def test_the_phantom_s_rows_are_found_used_and_reported(calibrated):
    narrowed, calibration, progress = calibrated
    result = calibration_result(calibration, narrowed)
    assert result.rows == (0, PHANTOM_ROWS)
    assert f"0:{PHANTOM_ROWS} show the phantom" in result.adjustments[0]
    true = THETA.source_frame(SCANNER.source_to_cor_mm)
    # The example's counts leave 0.03 mm at 360 views: rays of one cell are averaged before the logarithm.
    assert ray_error(SCANNER, true, result.source_frame).rms_mm < 0.06
    # The fit that found the rows is the answer: nothing is searched again.
    assert {one.stage for one in progress} == {"rows"}
    fractions = [one.fraction for one in progress]
    assert fractions == sorted(fractions)


def test_the_rows_that_are_found_give_the_answer_that_they_give_when_they_are_named(calibrated):
    narrowed, found, _ = calibrated
    _, named = run_calibration(narrowed, CalibrationOptions(), lambda _: None)
    np.testing.assert_array_equal(to_vector(found.frame), to_vector(named.frame))
    assert found.search == named.search


def test_the_log_beside_the_phantom_is_heard_in_views_six_degrees_apart(stack, calibrated):
    narrowed, calibration, _ = calibrated
    after, combined = with_second_witness(
        calibration, narrowed, row_range=None, rows=(0, stack.shape[1]), read=lambda row: stack[:, row]
    )
    witness = witness_of(combined, after)
    # At 60 views the average of rays within a cell shifts the phantom's and the log's answers apart by two deviations.
    assert (witness.agreement in {"agree", "strained"}, witness.taken, witness.log_jump_mm) == (True, "both", None)
    assert witness.log_rows[0] > PHANTOM_ROWS
    true = THETA.source_frame(SCANNER.source_to_cor_mm)
    assert abs(witness.log.cor_column_mm - true.cor_column_mm) < 3.0 * witness.log_standard_deviation.cor_column_mm


def test_a_stack_of_log_rows_only_keeps_all_of_them(stack):
    log = stack[:, PHANTOM_ROWS:]
    assert _in_phantom_rows(given(log), log, CalibrationOptions(), lambda _: None) is None
    with pytest.raises(CalibrationError) as caught:
        run_calibration(given(log), CalibrationOptions(), lambda _: None, stack=log)
    assert caught.value.code == "phantom-not-seen"
