"""A calibration's rows and the log beside them, its progress, and what it says of measured sides."""

import math
from datetime import date
from itertools import pairwise

import numpy as np
import pytest
from mill_scans import line_integrals
from pydantic import ValidationError

from sawmill_calibration.calibration import calibrate
from sawmill_calibration.calibration.calibrate import CalibrationInput, calibration_result, run_calibration
from sawmill_calibration.calibration.calibrate_scan import with_second_witness, witness_of
from sawmill_calibration.calibration.calibration_files import find_log_row
from sawmill_command.examples import SCANNER, full_turn, mill_slices, mill_stack
from sawmill_command.seeding import PHANTOM_ROWS, THETA
from sawmill_contracts.calibrations import CalibrationOptions
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.phantoms import BUILT_IN_PHANTOMS, PhantomDrawing, PhantomRequest
from sawmill_tomography.calibration.refusals import CalibrationError
from sawmill_tomography.geometry.geometry import TAU, to_vector
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.phantom import Disc, Phantom, Polygon
from sawmill_tomography.projection.analytic import DetectorCells, project


@pytest.fixture(scope="module")
def stack():
    made = mill_stack(60, mill_slices())
    counts, flats, darks = (part.astype(np.float32) for part in (made.counts, made.flats, made.darks))
    return line_integrals(counts, flats, darks).stack


def whole(stack):
    rows, scanner = (0, stack.shape[1]), ScannerConstants(**vars(SCANNER))
    mean = stack.mean(axis=1, dtype=np.float64)
    return CalibrationInput(mean, full_turn(60), rows, scanner, None, BUILT_IN_PHANTOMS["l-shape"], "0" * 64)


@pytest.fixture(scope="module")
def calibrated(stack):
    """With rows that nobody named: the input of those that were found, the calibration, and what was reported."""
    progress = []
    return *run_calibration(whole(stack), CalibrationOptions(), progress.append, stack=stack), progress


@pytest.mark.slow
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


@pytest.mark.slow
def test_the_rows_that_are_found_give_the_answer_that_they_give_when_they_are_named(calibrated):
    narrowed, found, _ = calibrated
    _, named = run_calibration(narrowed, CalibrationOptions(), lambda _: None)
    np.testing.assert_array_equal(to_vector(found.frame), to_vector(named.frame))
    assert found.search == named.search


@pytest.mark.slow
def test_the_log_beside_the_phantom_is_heard_in_views_six_degrees_apart(stack, calibrated):
    narrowed, calibration, _ = calibrated
    after, combined = with_second_witness(
        calibration, narrowed, row_range=None, rows=(0, stack.shape[1]), read=lambda row: stack[:, row]
    )
    witness = witness_of(combined, after)
    # At 60 views the average of rays within a cell shifts the phantom's and the log's answers apart by two deviations.
    assert (witness.agreement in {"agree", "strained"}, witness.used, witness.log_jump_mm) == (True, "both", None)
    assert witness.log_rows[0] > PHANTOM_ROWS
    true = THETA.source_frame(SCANNER.source_to_cor_mm)
    assert abs(witness.log.cor_column_mm - true.cor_column_mm) < 3.0 * witness.log_standard_deviation.cor_column_mm


@pytest.mark.slow
def test_a_stack_of_log_rows_only_has_no_rows_of_the_phantom(stack):
    log = stack[:, PHANTOM_ROWS:]
    with pytest.raises(CalibrationError) as caught:
        run_calibration(whole(log), CalibrationOptions(), lambda _: None, stack=log)
    assert caught.value.code == "phantom-not-seen"


@pytest.fixture
def given(constants, sinogram, turn):
    """The phantom in rows 3 to 5 of a scan; no row is judged by its drawing."""
    return CalibrationInput(sinogram(turn(24)), turn(24), (3, 6), constants, None, None, "")


@pytest.fixture
def shadow(scanner, theta, turn):
    seen_by = (DetectorCells.of(scanner), theta.source_frame(859.46), turn(24))
    return lambda *shapes: project(Phantom("body", shapes), *seen_by, rays_per_cell=8)


def test_a_log_is_looked_for_amid_the_longer_run_beside_the_phantom(given, shadow):
    log = shadow(Disc((5.0, -3.0), 120.0))
    assert find_log_row(given, (0, 12), lambda _: log).row == 9
    assert find_log_row(given, (0, 7), lambda _: log).row == 1


@pytest.mark.parametrize("rows", [(3, 6), (4, 5)])
def test_without_rows_beside_the_phantom_nothing_is_read(given, rows):
    assert find_log_row(given, rows, lambda _: pytest.fail("a row was read")) is None


def test_air_and_more_of_the_phantom_are_no_log_and_one_as_large_as_the_phantom_is(given, shadow):
    noise = np.random.default_rng(11).normal(size=given.sinogram.shape) * 0.02 * given.sinogram.std()
    assert find_log_row(given, (0, 12), lambda _: noise) is None
    # The same phantom, thicker by a tenth and 2 % of noise on it.
    assert find_log_row(given, (0, 12), lambda _: 1.1 * given.sinogram + noise) is None
    square = [(-130.0, -130.0), (130.0, -130.0), (130.0, 130.0), (-130.0, 130.0)]
    for shape in (Disc((0.0, 0.0), 150.0), Polygon(tuple(square))):
        row = shadow(shape)
        assert find_log_row(given, (0, 12), lambda _, row=row: row) is not None


@pytest.mark.slow
def test_the_fits_after_the_search_are_progress(sinogram, constants, monkeypatch):
    monkeypatch.setattr(calibrate, "STEPS_EVERY_S", 0.0)
    angles = (np.arange(40) + 0.5) * TAU / 40
    given = CalibrationInput(sinogram(angles), angles, (0, 1), constants, None, BUILT_IN_PHANTOMS["l-shape"], "0" * 64)
    reported = []
    run_calibration(given, CalibrationOptions(), reported.append)
    last_round = max(i for i, one in enumerate(reported) if i == 0 or one.generation != reported[i - 1].generation)
    assert last_round > 5, "steps of the search"
    assert len(reported) - last_round > 5, "steps of the fits"
    fractions = [one.fraction for one in reported]
    assert fractions == sorted(fractions)
    assert fractions[-1] < calibrate.SEARCH_DONE


def test_steps_without_end_go_on_being_progress():
    now_s, reported = [0.0], []
    reporting = calibrate.SearchProgress(reported.append, 0.5, monotonic=lambda: now_s[0])
    for _ in range(2000):
        now_s[0] += calibrate.STEPS_EVERY_S
        reporting.on_step()
    # After a million steps too, the next hundred are another fraction: it approaches its end by 1 / n.
    for _ in range(1_000_000):
        reporting.on_step()
    for _ in range(2):
        for _ in range(99):
            reporting.on_step()
        now_s[0] += calibrate.STEPS_EVERY_S
        reporting.on_step()
    fractions = [one.fraction for one in reported]
    assert all(now > before for before, now in pairwise(fractions))
    assert fractions[-1] < calibrate.SEARCH_DONE


def test_steps_are_told_once_a_second_and_rounds_at_once():
    now, reported = [0.0], []
    reporting = calibrate.SearchProgress(reported.append, 0.0, monotonic=lambda: now[0])
    for _ in range(50):
        now[0] += 0.1
        reporting.on_step()
    assert 4 <= len(reported) <= 5
    reporting.on_round(1, 3, math.inf)
    assert (reported[-1].generation, reported[-1].best_value) == (1, None)


BOARD = {"kind": "polygon", "vertices_mm": [(-100.0, -150.0), (100.0, -150.0), (100.0, 150.0), (-100.0, 150.0)]}
ACROSS = {"dimension": "x", "measured_mm": 200.0, "standard_uncertainty_mm": 0.2, "moisture_percent": 12.0}
ALONG = {"dimension": "y", "measured_mm": 300.0, "standard_uncertainty_mm": 0.06, "instrument": "caliper 12"}


def drawing(*measurements, **stated):
    return PhantomRequest(name="our board", shapes=[BOARD], measurements=list(measurements), **stated)


def reasons(*measurements, today="2021-06-01"):
    return list(calibrate.measurement_reasons(drawing(*measurements), date.fromisoformat(today)))


def test_measured_sides_give_the_size_tolerance_where_none_is_stated():
    # 0.1 % and 0.02 %: the root of the mean of their squares.
    assert drawing(ACROSS, ALONG).size_tolerance == pytest.approx((0.5 * (0.001**2 + 0.0002**2)) ** 0.5)
    assert drawing(ACROSS, size_tolerance=0.003).size_tolerance == 0.003
    assert drawing().size_tolerance == 0.0015


def test_a_measurement_is_kept_as_it_is_stored_and_one_that_is_none_is_refused_with_its_value():
    known = drawing(ACROSS | {"measured_on": "2021-01-31", "expires_on": "2022-01-31", "nominal_mm": 200.0}, ALONG)
    assert PhantomDrawing.model_validate(known.model_dump(mode="json")).model_dump() == known.model_dump()
    with pytest.raises(ValidationError, match="standard_uncertainty_mm 25 of measured_mm 200 must be less than 10%"):
        drawing(ACROSS | {"standard_uncertainty_mm": 25.0})


def test_a_measurement_that_has_expired_and_one_that_the_drawing_contradicts_are_reasons():
    dated = ACROSS | {"measured_on": "2020-05-31", "expires_on": "2021-05-31"}
    assert reasons(dated, today="2021-05-31") == []
    (found,) = reasons(dated)
    assert found.startswith("The phantom's measurement of x expired on 2021-05-31. Measure it again. It was 200.00 mm")
    # Three standard uncertainties of 0.06 mm.
    assert reasons(ALONG | {"measured_mm": 300.17}) == []
    (found,) = reasons(ALONG | {"measured_mm": 300.19})
    assert "drawn 300.00 mm along y, and was measured as 300.19 mm" in found
    # A length that is no extent of the drawing is not compared with one.
    assert reasons(ALONG | {"dimension": "the notch", "measured_mm": 40.0}) == []
