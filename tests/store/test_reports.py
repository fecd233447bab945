"""What people see of the queue, the workers and the database."""

from contextlib import closing
from datetime import timedelta

import pytest

from sawmill_contracts import job_kinds
from sawmill_platform.acting import Actor, acting_as
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.database.database import newest_revision
from sawmill_store.store import Store


def test_the_line_begins_with_whose_turn_is_next_and_names_who_asked(store, upload):
    with acting_as(Actor("line 2")):
        first = upload(store).job_id
    second = upload(store).job_id
    line = store.jobs.waiting_in_line()
    assert [(job.id, job.queue_position) for job in line] == [(first, 0), (second, 1)]
    assert line[0].asked_by == "line 2"
    assert store.jobs.waiting_in_line(kind=job_kinds.CALIBRATE) == []
    assert len(store.jobs.waiting_in_line(limit=1)) == 1


def test_jobs_that_have_ended_are_listed_however_they_did(store, upload, finish):
    done, dropped, waiting = (upload(store).job_id for _ in range(3))
    finish(store)
    store.jobs.request_cancel(dropped)
    ended = store.jobs.ended_page()
    assert [(job.id, job.state) for job in ended.items] == [
        (dropped, JobState.CANCELLED),
        (done, JobState.SUCCEEDED),
    ]
    assert waiting not in {job.id for job in ended.items}
    older = store.jobs.ended_page(limit=1)
    assert [job.id for job in store.jobs.ended_page(after=older.next).items] == [done]


@pytest.mark.dialect
def test_workers_are_known_by_their_last_attempt(store, upload, clock):
    upload(store)
    upload(store)
    begun = clock()
    with closing(Store(store.settings, clock=clock)) as ticking:
        ticking.jobs.claim("mill-1")
        clock.advance(minutes=5)
        ticking.jobs.claim("mill-2")
        seen = ticking.events.workers_since(begun)
        assert list(seen.items()) == [("mill-2", begun + timedelta(minutes=5)), ("mill-1", begun)]
        assert list(ticking.events.workers_since(begun + timedelta(seconds=1))) == ["mill-2"]


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
