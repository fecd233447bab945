"""What stays although rules of retention reach it."""

from sawmill_contracts.retention import RetentionKind, StaysBecause
from sawmill_mill.retention import STAYS


def test_every_kind_has_its_reasons():
    assert STAYS.keys() == set(RetentionKind)


def test_what_an_unfinished_job_needs_stays():
    kept = {kind for kind, reasons in STAYS.items() if StaysBecause.UNFINISHED_JOB in reasons}
    assert kept == set(RetentionKind) - {RetentionKind.EVENTS}


def test_a_calibration_that_was_ever_used_stays_and_a_reconstruction_may_go():
    used = {StaysBecause.ACTIVE_CALIBRATION, StaysBecause.ONCE_ACTIVE, StaysBecause.REFERRED_TO}
    assert used < set(STAYS[RetentionKind.CALIBRATIONS])
    assert not used & set(STAYS[RetentionKind.RECONSTRUCTIONS])
