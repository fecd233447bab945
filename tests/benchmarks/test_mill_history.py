"""The mill that the documents' pictures show: a day of it."""

import shutil
from contextlib import closing
from datetime import timedelta

import pytest
from mill_history import Line, PastClock, write_history

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
