"""A store in a temporary folder, and what is needed to fill it."""

import shutil
from contextlib import closing
from datetime import UTC, datetime, timedelta
from itertools import count

import pytest
from emptied_databases import EmptiedDatabases
from results import CONSTANTS, RESULTS, succeed
from sqlalchemy import insert

from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.contracts.jobs import Failure, FailureKind, JobState
from sawmill_platform.database.database import Database
from sawmill_platform.database.engines import make_engine
from sawmill_platform.database.tables import JobRow
from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store
from sawmill_vocabulary import DataKind


class TestClock:
    __test__ = False

    def __init__(self):
        self.now = datetime(2026, 3, 2, 5, 0, tzinfo=UTC)

    def __call__(self):
        return self.now

    def advance(self, **step):
        self.now += timedelta(**step)


@pytest.fixture
def clock():
    return TestClock()


@pytest.fixture(scope="session")
def databases(postgres, tmp_path_factory):
    return EmptiedDatabases(postgres, tmp_path_factory.mktemp("template"))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Leave PostgreSQL to `make nightly`, except where a test is marked `dialect` or is about PostgreSQL alone."""
    for item in items:
        on_postgresql = getattr(item, "callspec", None) and item.callspec.params.get("database_url") == "postgresql"
        alone = any(mark.args[:1] == ("database_url",) for mark in item.iter_markers("parametrize"))
        if on_postgresql and not alone and not item.get_closest_marker("dialect"):
            item.add_marker("nightly")


@pytest.fixture(params=["sqlite", "postgresql"])
def database_url(request):
    if request.param == "sqlite":
        yield None
        return
    with request.getfixturevalue("databases").one() as url:
        yield url


@pytest.fixture
def empty_url(request, database_url, tmp_path):
    return f"sqlite:///{tmp_path}/empty.db" if database_url is None else request.getfixturevalue("postgres_url")


@pytest.fixture
def settings(tmp_path, database_url):
    return StorageSettings(data_folder=tmp_path / "data", database_url=database_url)


@pytest.fixture
def filled(request, settings, empty_data):
    """Of a store whose tables and built-in phantoms are there: that is quicker than migrating."""
    on_sqlite = settings.database_url is None
    shutil.copytree(empty_data if on_sqlite else request.getfixturevalue("databases").data, settings.data_folder)
    return settings


@pytest.fixture
def store(request, filled):
    """A store, whose clock a test moves that is marked `clocked`."""
    clocked = request.node.get_closest_marker("clocked")
    with closing(Store(filled, clock=request.getfixturevalue("clock") if clocked else None)) as opened:
        yield opened


@pytest.fixture
def scanner(store):
    return store.scanners.create(ScannerSpec(name="Line 2", constants=ScannerConstants(**CONSTANTS)))


@pytest.fixture
def upload(scanner):
    def accept(store, *, phantom_id="l-shape", scan_id=None, received=None):
        spec = ScanSpec(scanner_id=scanner.id, data=DataKind.COUNTS, phantom_id=phantom_id)
        received = received or store.files.receive([b"scan"], max_bytes=10)
        return store.scans.accept(spec, received, scan_id=scan_id)

    return accept


@pytest.fixture
def finish():
    """Do the oldest job as a worker would, without any science."""

    def do(store, **changes):
        claim = store.jobs.claim("test")
        result = RESULTS[claim.job.kind](**changes)
        return succeed(
            store, claim, write=lambda output: (output / "result").write_text(f"attempt {claim.attempt}"), result=result
        )

    return do


@pytest.fixture
def refuse(store):
    def fail(detail="no phantom is seen"):
        failure = Failure(kind=FailureKind.INPUT, code="phantom-not-seen", detail=detail)
        return store.jobs.fail(store.jobs.claim("test"), failure)

    return fail


@pytest.fixture
def ready_scan(store, upload, finish):
    accepted = upload(store)
    finish(store)
    return store.scans.get(accepted.id)


@pytest.fixture
def add_jobs(filled, clock):
    """Rows of jobs, a second apart; an id begins with the job's group, or with its kind where it has none."""
    database = Database(make_engine(filled.url), clock)
    numbers = count()

    def insert_rows(number, kind, *, took_s=None, **values):
        with database.write() as session:
            for _ in range(number):
                clock.advance(seconds=1)
                name = f"{values.get('group_id', kind)}-{next(numbers):04d}"
                row = {"id": name, "subject_id": name, "kind": kind, "state": JobState.QUEUED, "created_at": clock()}
                if took_s is not None:
                    start = clock()
                    clock.advance(seconds=took_s)
                    row |= {"state": JobState.SUCCEEDED, "started_at": start, "finished_at": clock()}
                session.execute(insert(JobRow), [row | values])

    yield insert_rows
    database.engine.dispose()
