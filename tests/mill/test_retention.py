"""What rules of retention never delete."""

from sawmill_contracts.retention import RetentionKind, StaysBecause
from sawmill_mill.retention import STAYS, stays_because


def test_each_kind_stays_for_its_reasons_alone():
    assert STAYS.keys() == set(RetentionKind)
    for kind, reasons in STAYS.items():
        assert stays_because(kind, set(StaysBecause)) == list(reasons)
        assert stays_because(kind, []) == []


def test_what_a_job_needs_stays_and_events_have_no_jobs():
    kept = {kind for kind in RetentionKind if stays_because(kind, [StaysBecause.UNFINISHED_JOB])}
    assert kept == set(RetentionKind) - {RetentionKind.EVENTS}


def test_a_calibration_that_was_ever_used_stays_and_a_reconstruction_may_go():
    used = [StaysBecause.ONCE_ACTIVE, StaysBecause.REFERRED_TO]
    assert stays_because(RetentionKind.CALIBRATIONS, used) == used
    assert stays_because(RetentionKind.RECONSTRUCTIONS, used) == []
