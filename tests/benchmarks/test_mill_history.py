"""The mill that the documents' pictures show, and a year of a busy one: 100 000 jobs, 20 000 scans, 200 000 events."""

import asyncio
import shutil
from contextlib import closing
from datetime import timedelta

import pages
import pytest
from mill_history import Line, PastClock, write_history

from sawmill_platform.database.database import Database
from sawmill_platform.database.engines import make_engine
from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store

pytestmark = pytest.mark.nightly


def test_a_day_is_computed_at_its_time_in_the_past(tmp_path, empty_data):
    shutil.copytree(empty_data, tmp_path / "data")
    clock = PastClock()
    today = clock.now
    lines = [Line("moved", lambda _: 1.0), Line("new", lambda _: 0.0, watched=False)]
    with closing(Store(StorageSettings(data_folder=tmp_path / "data", database_url=None), clock=clock)) as store:
        write_history(store, clock, lines=lines, days=0)
        new, moved = sorted(store.scanners.page().items, key=lambda scanner: scanner.name, reverse=True)
        (found,) = store.calibrations.page(scanner_id=moved.id).items
        assert (new.active_calibration_id, moved.active_calibration_id) == (None, found.id)
        assert (found.verdict, today - found.created_at) == ("pass", timedelta(minutes=59))
        assert len(store.schedules.page().items) == 2
    assert clock.now == today


@pytest.mark.nightly
def test_no_page_and_no_list_takes_more_than_0_3_s_of_processor(tmp_path):
    settings = StorageSettings(data_folder=tmp_path, database_url=None)
    store = Store.open(settings)
    pages.fill(store, Database(make_engine(settings.url)), scanners=5, scans=22_000, checks=3)
    assert sum(store.jobs.counts().values()) >= 100_000
    answers = asyncio.run(pages.measured(store))
    store.close()
    assert {answer.path: answer.worked_ms for answer in answers if answer.worked_ms > 300.0} == {}
    assert len(answers) > 100
