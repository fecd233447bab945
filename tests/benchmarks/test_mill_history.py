"""A year of a busy mill: 100 000 jobs, 20 000 scans, 200 000 events."""

import asyncio

import pages
import pytest

from sawmill_platform.database.database import Database
from sawmill_platform.database.engines import make_engine
from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store

pytestmark = pytest.mark.nightly


def test_no_page_and_no_list_takes_more_than_0_3_s_of_processor(tmp_path):
    settings = StorageSettings(data_folder=tmp_path, database_url=None)
    store = Store.open(settings)
    pages.fill(store, Database(make_engine(settings.url)), scanners=5, scans=22_000, checks=3)
    assert sum(store.jobs.counts().values()) >= 100_000
    answers = asyncio.run(pages.measured(store))
    store.close()
    assert {answer.path: answer.worked_ms for answer in answers if answer.worked_ms > 300.0} == {}
    assert len(answers) > 100
