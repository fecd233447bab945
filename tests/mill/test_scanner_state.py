"""How a scanner stands, by its newest calibration, the movement since the active one, and its alarms."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from sawmill_contracts.alarms import AlarmKind
from sawmill_contracts.calibrations import Comparison
from sawmill_mill.scanner_state import Calibrated, Checked, ScannerState

NOON = datetime(2026, 3, 2, 12, 0, tzinfo=UTC)
LATER = NOON + timedelta(hours=1)
ACTIVE = ScannerState(newest=Calibrated("active", NOON, "pass"), active_id="active")


def compared(moved_mm=0.05, *, within=True, against="active", verdict="pass", reasons=()):
    """The state with a newer calibration, which is compared with one."""
    comparison = Comparison(
        calibration_id=against,
        ray_change_mm=moved_mm,
        angle_change_deg=0.0,
        cor_column_change_mm=0.0,
        source_distance_change_mm=0.0,
        tilt_change_deg=0.0,
        tolerance_mm=0.5,
        within_tolerance=within,
        reason="something moved",
    )
    return replace(ACTIVE, newest=Calibrated("newer", NOON, verdict, reasons, comparison))


def checked(moved_mm=0.05, *, within=True, at=LATER):
    return Checked(at, "active", within, moved_mm, 0.5, "the COR moved")


def word(state):
    return state.standing.tone, state.standing.word


@pytest.mark.parametrize(
    ("state", "expected"),
    [
        (ScannerState(scanned=False), ("idle", "New")),
        (ScannerState(), ("idle", "Never calibrated")),
        (ScannerState(failure="no phantom"), ("bad", "Calibration failed")),
        (ACTIVE, ("good", "Fine")),
        (replace(ACTIVE, failure="no phantom"), ("watch", "Last calibration failed")),
        (replace(ACTIVE, active_id=None), ("watch", "Not accepted")),
        (replace(ACTIVE, active_id="older"), ("watch", "Watch")),
        (replace(ACTIVE, alarms=(AlarmKind.SCANNER_QUIET,)), ("watch", "Watch")),
        (compared(), ("good", "Fine")),
        # From 0.7 of what is allowed on.
        (compared(0.349), ("good", "Fine")),
        (compared(0.35), ("watch", "Watch")),
        (compared(0.75, within=False), ("bad", "Out of tolerance")),
        (compared(0.75, within=False, against="another"), ("watch", "Watch")),
        (compared(verdict="watch"), ("watch", "Watch")),
        (compared(0.75, within=False, verdict="fail"), ("bad", "Calibration failed")),
        (replace(ACTIVE, seen=checked()), ("good", "Fine")),
        (replace(ACTIVE, seen=checked(0.43)), ("watch", "Watch")),
        (replace(ACTIVE, seen=checked(0.8, within=False)), ("bad", "Out of tolerance")),
        (replace(ACTIVE, seen=checked(0.8, within=False, at=NOON - timedelta(hours=1))), ("good", "Fine")),
    ],
)
def test_each_state_has_a_word_and_a_colour(state, expected):
    assert word(state) == expected
    assert state.needs_somebody is (expected[0] != "good")
    assert state.standing.sentence.endswith(".") or state.standing.scientific


def test_reasons_become_sentences_and_a_symbol_stays_as_it_is():
    state = compared(verdict="fail", reasons=("the residual is too large", "h_S is not resolved."))
    assert state.standing.sentence == "The residual is too large. h_S is not resolved."
    assert replace(ACTIVE, seen=checked(0.8, within=False)).standing.sentence == "A log shows: the COR moved."


def test_a_passing_calibration_is_reviewed_and_a_scanner_that_has_moved_is_calibrated():
    assert replace(ACTIVE, active_id=None).wants_review
    assert compared(0.75, within=False).wants_review
    assert not compared(verdict="fail").wants_review
    assert not replace(compared(), seen=checked(0.8, within=False)).wants_review
    assert not replace(ACTIVE, active_id="older").wants_review


def test_movement_that_the_active_calibration_took_up_has_no_colour():
    taken_up = replace(compared(1.4, within=False), active_id="newer")
    assert word(taken_up) == ("good", "Fine")
    assert (taken_up.moved.tone, taken_up.moved.since_active) == ("idle", False)


def test_a_check_that_could_not_tell_takes_nothing_back():
    untold = Checked(LATER, "active", within_tolerance=None)
    state = replace(ACTIVE, last_check=untold, seen=checked(0.62, within=False))
    assert state.unseen
    assert word(state) == ("bad", "Out of tolerance")
    assert not replace(state, last_check=untold._replace(calibration_id="another")).unseen
    assert not replace(state, last_check=checked()).unseen
