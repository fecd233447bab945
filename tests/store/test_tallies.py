"""Counts for metrics, and what people see of the workers and the database, on both databases."""

from datetime import timedelta

import pytest
from results import answer_of, reading

from sawmill_contracts import kinds
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.jobs import Failure, FailureKind, JobState
from sawmill_platform.database.database import newest_revision
from sawmill_platform.jobs.job_store import Pulse
from sawmill_platform.jobs.tallies import SETTLED, Amount, Fate, Tallies

pytestmark = pytest.mark.clocked

REFUSED = Failure(kind=FailureKind.INPUT, code="broken-file", detail="it is damaged")
SUCCEEDED, FAILED, LOST = event_kinds.SUCCEEDED, event_kinds.FAILED, event_kinds.LOST


@pytest.fixture
def end(store, upload, clock):
    """Have a scan read in some seconds."""

    def run(seconds, *, peak_memory_bytes=None, failure=None):
        upload(store)
        claim = store.jobs.claim("host-1")
        clock.advance(seconds=seconds)
        if failure is not None:
            store.jobs.fail(claim, failure, peak_memory_bytes=peak_memory_bytes)
            return
        output = store.files.make_attempt_folder(claim.job_id, claim.attempt)
        store.jobs.succeed(claim, answer_of(claim.job.kind, reading()), output, peak_memory_bytes=peak_memory_bytes)

    return run


def of_ingest(what, *, duration):
    return Fate(what, kinds.INGEST, None, None, duration)


@pytest.mark.dialect
def test_ends_are_classed_by_how_long_they_took_and_what_went_wrong(store, end):
    end(0.5, peak_memory_bytes=3_000_000_000)
    end(0.75, peak_memory_bytes=1_000_000_000)
    end(20.0)
    end(1.0, failure=REFUSED, peak_memory_bytes=500)
    fates = store.tallies.read().fates
    assert fates[of_ingest(SUCCEEDED, duration=1)] == pytest.approx((2, 1.25, 2, 4e9, 3e9), abs=1e-3)
    assert fates[of_ingest(SUCCEEDED, duration=4)] == pytest.approx((1, 20.0, 0, 0.0, 0.0), abs=1e-3)
    (failed,) = (fate for fate in fates if fate.type is FAILED)
    assert (failed.fault, failed.code, fates[failed].number) == ("input", "broken-file", 1)


@pytest.mark.dialect
def test_what_is_counted_grows_whether_it_was_counted_before_or_not(store, end, clock):
    """What has settled is read once, and what has not each time: together each attempt counts once."""
    counts = []
    for number in range(3):
        end(1.5)
        counts.append(store.tallies.read().fates[of_ingest(SUCCEEDED, duration=2)].number)
        assert number or not store.tallies.counted_to, "an event of a lower number may be committed later"
        clock.advance(seconds=0.6 * SETTLED.total_seconds())
    assert counts == [1, 2, 3]
    assert store.tallies.read().fates == Tallies(store.database).read().fates
    assert store.tallies.counted_to > 0


@pytest.mark.dialect
def test_jobs_are_counted_by_kind_and_state_with_the_age_of_the_oldest(store, upload, clock):
    for _ in range(2):
        upload(store)
        clock.advance(seconds=30)
    store.jobs.claim("host-1")
    clock.advance(seconds=5)
    tally = store.tallies.read()
    assert tally.jobs == {(kinds.INGEST, JobState.QUEUED): 1, (kinds.INGEST, JobState.RUNNING): 1}
    assert (tally.queued_s, tally.running_s) == ({kinds.INGEST: 35.0}, {kinds.INGEST: 5.0})


def test_a_lost_attempt_and_a_job_cancelled_in_the_queue(store, upload):
    upload(store)
    claim = store.jobs.claim("host-1")
    store.jobs.take_back(Pulse(claim.job_id, claim.attempt, 0, cancel_requested=False))
    store.jobs.request_cancel(claim.job_id)
    ((fate, amount),) = store.tallies.read().fates.items()
    assert (fate.type, fate.code, amount) == (LOST, "worker-lost", Amount(1, 0.0, 0, 0.0, 0.0))


def test_workers_are_seen_for_a_while(store, end, upload, clock):
    end(1.0)
    upload(store)
    store.jobs.claim("host-2")
    assert store.tallies.read().workers == 2
    clock.advance(hours=1)
    assert store.tallies.read().workers == 1  # it holds its attempt still


@pytest.mark.dialect
def test_workers_are_known_by_their_last_attempt(store, upload, clock):
    for _ in range(2):
        upload(store)
    begun = clock()
    store.jobs.claim("mill-1")
    clock.advance(minutes=5)
    store.jobs.claim("mill-2")
    assert list(store.events.workers_since(begun).items()) == [("mill-2", clock()), ("mill-1", begun)]
    assert list(store.events.workers_since(begun + timedelta(seconds=1))) == ["mill-2"]


@pytest.mark.dialect
def test_a_database_reports_what_it_is(store, database_url, upload):
    report = store.database_report()
    assert report.system.startswith("PostgreSQL" if database_url else "SQLite")
    assert report.migration == report.newest_migration == newest_revision()
    assert 0 < report.answered_s < 60  # it answered; how fast is the machine's
    assert report.size_bytes > 100_000  # thirty tables and indexes of a page each, at least
    before = store.scans.uploaded_bytes()
    scan = upload(store)
    assert store.scans.uploaded_bytes() == before + scan.size_bytes
