"""What people see of the queue, the workers and the database."""

from contextlib import closing
from datetime import timedelta

import pytest

from sawmill_platform.database.database import newest_revision
from sawmill_store.store import Store


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
