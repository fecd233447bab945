from contextlib import closing

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from emptied_databases import sqlite_alone
from live_service import race
from results import CONSTANTS
from sqlalchemy import event, text

from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.schedules import ScheduleSpec
from sawmill_platform.database.database import Database, newest_revision
from sawmill_platform.database.engines import make_engine
from sawmill_platform.database.tables import Base
from sawmill_platform.errors import StorageFull, StorageUnavailable
from sawmill_store.store import Store
from sawmill_vocabulary.version import VERSION

pytestmark = pytest.mark.slow

MIGRATIONS = Base.metadata.info["migrations"]


@pytest.mark.dialect
def test_the_migrations_make_the_tables_of_the_models(store):
    with store.database.engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, Base.metadata) == []


@pytest.mark.dialect
def test_the_newest_revision_is_alembics_head_and_not_migrated_again(store):
    assert newest_revision() == ScriptDirectory(MIGRATIONS).get_current_head()
    statements = []
    event.listen(store.database.engine, "before_cursor_execute", lambda *given: statements.append(given[2]))
    store.database.upgrade()
    assert [each for each in statements if each.startswith(("CREATE", "ALTER", "DROP", "INSERT", "UPDATE"))] == []
    with store.database.read() as session:
        assert session.scalar(text("SELECT product_version FROM alembic_version")) == VERSION


@pytest.mark.dialect
def test_jobs_from_before_are_kept_and_may_start_whatever_version_left_them(settings, empty_url):
    database = Database(make_engine(empty_url))
    revisions = sorted(path.name[:4] for path in (MIGRATIONS / "versions").glob("0*.py"))[:-1]
    for number, revision in enumerate(revisions):
        database.upgrade(revision)
        with database.write() as session:
            columns = "id, created_at, kind, state, subject_id, attempt, cancel_requested"
            values = f"'{revision}', '2026-03-02 05:00:{number:02}', 'ingest', 'queued', 'old', 2, false"
            session.execute(text(f"INSERT INTO jobs ({columns}) VALUES ({values})"))  # noqa: S608 - constants
    database.engine.dispose()
    upgraded = Store.open(settings.model_copy(update={"database_url": empty_url}))
    held = [upgraded.jobs.claim("test") for _ in revisions]
    upgraded.close()
    assert [claim.job_id for claim in held] == revisions
    assert {(claim.attempt, claim.job.losses, claim.job.background) for claim in held} == {(3, 0, False)}


def test_a_schedule_from_before_time_zones_runs_as_it_did_and_is_unchanged_by_the_same(settings, empty_url):
    database = Database(make_engine(empty_url))
    database.upgrade("0003")
    spec = ScheduleSpec(scanner_id="old", cron="30 5 * * *")
    scanner = ScannerSpec(name="Line 1", constants=ScannerConstants(**CONSTANTS)).model_dump_json()
    due = {"at": "2026-03-02 05:30:00", "options": spec.options.model_dump_json(), "scanner": scanner}
    columns = "id, created_at, scanner_id, cron, enabled, on_pass, options, next_due_at"
    values = "'daily', :at, 'old', '30 5 * * *', true, 'report', :options, :at"
    with database.write() as session:
        for statement in (
            "INSERT INTO scanners (id, created_at, spec) VALUES ('old', :at, :scanner)",
            f"INSERT INTO schedules ({columns}) VALUES ({values})",  # noqa: S608 - constants
            "INSERT INTO schedule_runs (schedule_id, due_at, outcome) VALUES ('daily', :at, 'no-new-phantom-scan')",
        ):
            names = {name for name in due if f":{name}" in statement}
            session.execute(text(statement), {name: due[name] for name in names})
    database.engine.dispose()
    upgraded = Store.open(settings.model_copy(update={"database_url": empty_url}))
    kept = upgraded.schedules.get("daily")
    assert ScheduleSpec.model_validate(kept.model_dump(include=set(ScheduleSpec.model_fields))) == spec
    assert (kept.last_run.outcome, kept.last_run.drift_id) == ("no-new-phantom-scan", None)
    upgraded.schedules.update("daily", spec)
    (entry,) = upgraded.audit.all()
    upgraded.close()
    assert entry.detail == {}


@sqlite_alone
def test_a_commit_is_durable_and_references_are_checked(store):
    with store.database.read() as session:
        pragmas = {name: session.execute(text(f"PRAGMA {name}")).scalar() for name in ("journal_mode", "synchronous")}
        foreign_keys = session.execute(text("PRAGMA foreign_keys")).scalar()
    assert pragmas == {"journal_mode": "wal", "synchronous": 2}
    assert foreign_keys == 1


@pytest.mark.dialect
def test_several_processes_may_open_a_new_store_at_once(tmp_path, empty_url):
    imports = (
        "from functools import partial\nfrom pathlib import Path\nfrom threading import Event\nimport alembic.command\n"
        "from sawmill_platform.workers.program import open_store\n"
        "from sawmill_platform.settings import StorageSettings\nfrom sawmill_store.store import Store"
    )
    program = (
        f"settings = StorageSettings(data_folder=Path({str(tmp_path / 'data')!r}), database_url={empty_url!r})\n"
        "print('phantoms', len(open_store(partial(Store.open, settings), Event()).phantoms.page().items))"
    )
    # What waits for the others is logged as well.
    answers = [line for line in race(2, imports, program).splitlines() if line.startswith("phantoms")]
    assert answers == ["phantoms 2"] * 2


def test_a_database_that_is_no_database_is_reported_in_a_sentence(tmp_path):
    (tmp_path / "not-a-folder").write_text("")
    database = Database(make_engine(f"sqlite:///{tmp_path}/not-a-folder/sawmill.db"))
    with pytest.raises(StorageUnavailable, match="does not answer"), database.read() as session:
        session.execute(text("SELECT 1"))


def test_check_reports_a_folder_that_cannot_be_written_to_and_a_disk_below_its_reserve(store, monkeypatch):
    store.check()
    with pytest.raises(StorageFull, match=f"and writing a result needs {2**61};"):
        store.check(reserve_bytes=2**61)
    low = store.settings.model_copy(update={"disk_reserve_bytes": 2**62})
    with closing(Store(low)) as reserved, pytest.raises(StorageFull, match=f"SAWMILL_DISK_RESERVE_BYTES needs {2**62}"):
        reserved.check()
    assert list((store.files.folder / "incoming").iterdir()) == []
    monkeypatch.setattr("os.access", lambda *_: False)  # root may write anywhere
    with pytest.raises(StorageUnavailable, match="cannot be written to"):
        store.check()
