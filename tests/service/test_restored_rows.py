"""Rows of a backup that somebody made by hand: each is read by its contract, and what is restored makes every page."""

import html
import json
import re
import shutil
import tarfile
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
from make_data_0_1_0 import ARCHIVE
from sqlalchemy import JSON, Boolean, Column, Date, Enum, Float, Integer, String, select

from sawmill_contracts import mill_events
from sawmill_contracts.alarms import AlarmKind
from sawmill_contracts.measurements import MeasurementKind
from sawmill_contracts.scanner_drift import DriftFinding
from sawmill_platform.backups.manifest import read_manifest
from sawmill_platform.backups.row_contracts import refuse_unfit_row
from sawmill_platform.backups.rows import LEFT_OUT, read_rows
from sawmill_platform.contracts.keys import KeyAsk, Scope
from sawmill_platform.contracts.webhooks import DeliveryState
from sawmill_platform.database.database import Database
from sawmill_platform.database.engines import make_engine
from sawmill_platform.database.tables import (
    Base,
    DeliveryRow,
    JobDependencyRow,
    Ranked,
    Registered,
    RepeatRow,
    SenderRow,
    UtcDateTime,
)
from sawmill_platform.errors import Damaged
from sawmill_platform.keys.repeats import KeptAnswer
from sawmill_platform.settings import StorageSettings
from sawmill_store.backups import READERS, restore, take_backup
from sawmill_store.mill_tables import (
    ActivationRow,
    AlarmRow,
    DriftChartRow,
    MeasurementRow,
    RetentionRow,
    ScheduleRunRow,
)
from sawmill_store.store import Store

pytestmark = pytest.mark.slow

TABLES = sorted(Base.metadata.tables.keys() - LEFT_OUT)
FINDING = DriftFinding(kind="quiet", evidence=1.0, limit=30.0, scatter=1.0).model_dump(mode="json")


def silent(_progress: object) -> None:
    """Nobody looks at the progress."""


def fill_the_other_tables(store: Store) -> None:
    """Add a row to each table that the examples leave empty."""
    now = store.now()
    store.keys.create(KeyAsk(name="line 2", scope=Scope.SUBMIT))
    with store.database.write() as session:
        active = session.scalars(select(ActivationRow)).one()
        look = session.scalars(select(MeasurementRow).where(MeasurementRow.kind == MeasurementKind.DRIFT)).one()
        look.method, look.activation_number, look.awaits_chart, look.pooled_looks = "view-pairs", active.number, None, 1
        look.pooled_cor_column_mm = look.pooled_cor_column_standard_deviation_mm = 0.1
        look.pooled_tilt_rad = look.pooled_tilt_standard_deviation_rad = 0.1
        about = {"scanner_id": "example", "method": "view-pairs", "activation_number": active.number, "looks": 1}
        found = {"changed_at": now, "finding": FINDING, "alarm": {"at": now.isoformat(), "finding": FINDING}}
        answer = KeptAnswer(status=201, headers={}, body="{}")
        removed = {"log-scans": 1}
        session.add_all(
            [
                JobDependencyRow(job_id="example", needs_job_id=store.calibrations.get("example").job_id),
                DriftChartRow(**about, **found, state={}),
                AlarmRow(scanner_id="example", what=AlarmKind.SCANNER_QUIET, since=now, last_at=now, limit_hours=1.0),
                RetentionRow(number=1, rules={}, revision=1, changed_at=now, changed_by="test", removed=removed),
                ScheduleRunRow(schedule_id="example", due_at=now, outcome="queued", calibration_id="example"),
                RepeatRow(caller="a", key="b", created_at=now, request_sha256="0" * 64, answer=asdict(answer)),
                SenderRow(number=1, holder="a", held_until=now),
                DeliveryRow(
                    webhook_id="example",
                    event_number=1,
                    message_id="msg_1",
                    what=mill_events.ALARM_OPENED,
                    state=DeliveryState.DELIVERED,
                    attempts=1,
                    first_at=now,
                    last_at=now,
                ),
            ]
        )


@pytest.fixture(scope="module")
def backup(seeded_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a service with a row in each table."""
    folder = tmp_path_factory.mktemp("backup")
    settings = StorageSettings(data_folder=shutil.copytree(seeded_data, folder / "data"), database_url=None)
    with closing(Store(settings)) as store:
        fill_the_other_tables(store)
    (folder / "disk").mkdir()
    return take_backup(settings, folder / "disk", silent).path


@pytest.fixture(scope="module")
def empty_tables(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Database]:
    database = Database(make_engine(f"sqlite:///{tmp_path_factory.mktemp('empty')}/sawmill.db"))
    database.upgrade()
    yield database
    database.engine.dispose()


@pytest.fixture
def changed(backup: Path, tmp_path: Path, empty_tables: Database) -> Callable[..., str | None]:
    """Change a value in the first row that has one, and read all rows as a restore does: why they are refused."""
    folder = tmp_path / "changed"
    shutil.copytree(backup / "rows", folder / "rows")
    tables = read_manifest(backup).tables

    def refusal(table: str, column: str, value: Any) -> str | None:
        path = folder / "rows" / f"{table}.jsonl"
        rows = [json.loads(line) for line in (backup / "rows" / path.name).read_text().splitlines()]
        row = next((row for row in rows if row[column] is not None), rows[0])
        row[column] = value(row[column]) if callable(value) else value
        path.write_text("".join(f"{json.dumps(row)}\n" for row in rows))
        try:
            with empty_tables.write() as session:
                read_rows(session.connection(), folder, tables)
                refuse_unfit_row(session, folder, READERS)
                session.rollback()
        except Damaged as error:
            return str(error)
        finally:
            shutil.copy(backup / "rows" / path.name, path)
        return None

    return refusal


def misfits(column: Column[Any]) -> list[Any]:
    """Values that a column never has."""
    kinds: list[tuple[type, list[Any]]] = [
        (JSON, [7]),
        (UtcDateTime, ["never", "2026-03-02T05:30:00", "0001-01-01T00:00:00+14:00"]),
        (Date, ["never"]),
        (Boolean, [7]),
        (Enum, ["nonsense"]),
        (Ranked, [99]),
        (Registered, [7, "nonsense"]),
        (Integer, ["x", 2**63]),
        (Float, ["x", True]),
        (String, [7, "\ud800"]),
    ]
    values = next(values for kind, values in kinds if isinstance(column.type, kind))
    return [*values, "../../x"] if column.name == "id" or column.foreign_keys else values


def test_each_table_is_read_by_a_contract():
    assert sorted(kind.__tablename__ for kind in READERS) == TABLES


@pytest.mark.parametrize("table", [pytest.param(table, marks=pytest.mark.nightly) for table in TABLES])
def test_each_column_of_each_table_is_read(changed, backup, table):
    assert (backup / "rows" / f"{table}.jsonl").read_text(), "the table has a row"
    taken = []
    for column in Base.metadata.tables[table].columns:
        for value in misfits(column):
            refusal = changed(table, column.name, value)
            # A row that refers to one of another id may be the one that is refused.
            if refusal is None or not (f"rows/{table}.jsonl" in refusal or column.name == "id"):
                taken.append((column.name, value, refusal))
    assert taken == []


@pytest.mark.parametrize(
    ("table", "column", "value", "words"),
    [
        ("scans", "id", "../../../../x", "line 1 of rows/scans.jsonl is refused: id: String should match pattern"),
        ("jobs", "state", "nonsense", "line 1 of rows/jobs.jsonl is refused: 'nonsense' is not among"),
        ("scanners", "spec", {"name": 7}, "line 1 of rows/scanners.jsonl is refused: name: .* valid string, not 7"),
        ("scanners", "spec", [], "line 1 of rows/scanners.jsonl is refused"),
        ("events", "number", 2**63, "line 1 of rows/events.jsonl is no row: number must be a whole number of at most"),
        ("events", "number", 2**31 - 1, "line 1 of rows/events.jsonl is no row: number must be"),
        ("events", "detail", {"a": "\ud800"}, "rows/events.jsonl is refused"),
        (
            "drifts",
            "job_id",
            "example",
            "line 1 of rows/drifts.jsonl is refused: job_id: 'example' is a job of",
        ),
        ("alarms", "last_at", None, "line 1 of rows/alarms.jsonl is refused: last_at: an alarm scanner-quiet has one"),
        ("calibrations", "result", lambda old: old | {"covariance": [[0.0] * 5]}, "covariance: a covariance must have"),
        ("repeats", "answer", lambda old: old | {"body": 7}, "line 1 of rows/repeats.jsonl is refused: body: "),
        ("scans", "reading", lambda old: old | {"shape": None}, "line 1 of rows/scans.jsonl is refused: shape: "),
        ("drifts", "result", lambda old: old | {"tolerance_mm": 0}, "tolerance_mm: .* greater than 0, not 0"),
        ("calibrations", "result", None, "its job has succeeded, and it has no result"),
        ("schedules", "cron", "at noon", "line 1 of rows/schedules.jsonl is refused: cron must be five fields"),
        ("activations", "calibration_id", "gone", "the database refuses line 1 of rows/activations.jsonl: FOREIGN KEY"),
    ],
)
def test_a_row_that_its_contract_refuses_is_named_with_its_line(changed, table, column, value, words):
    assert re.search(words, changed(table, column, value)) is not None


@pytest.fixture
def store(request: pytest.FixtureRequest, backup: Path, tmp_path: Path) -> Iterator[Store]:
    """A restored store: of the backup, or of one of a data folder of version 0.1.0."""
    if request.param == "0.1.0":
        with tarfile.open(ARCHIVE) as archive:
            archive.extractall(tmp_path / "data", filter="data")
        (tmp_path / "disk").mkdir()
        data = StorageSettings(data_folder=tmp_path / "data", database_url=None)
        backup = take_backup(data, tmp_path / "disk", silent).path
        assert read_manifest(backup).revision == "0003"
    restored = StorageSettings(data_folder=tmp_path / "restored", database_url=None)
    restore(backup, restored, silent)
    with closing(Store.open(restored)) as opened:
        yield opened


@pytest.mark.nightly
@pytest.mark.parametrize("store", ["now", "0.1.0"], indirect=True)
def test_what_is_restored_makes_every_page(client):
    statuses: dict[str, int] = {}
    ahead = ["/", *(path for path, methods in client.app.openapi()["paths"].items() if "get" in methods)]
    while ahead:
        path = ahead.pop()
        if path in statuses or "{" in path or path == "/v1/events":  # a stream
            continue
        answer = client.get(path)
        statuses[path] = answer.status_code
        if answer.headers.get("Content-Type", "").startswith("text/html"):
            ahead += (html.unescape(link) for link in re.findall(r'(?:href|src)="(/[^"#]*)', answer.text))
    assert {path: status for path, status in statuses.items() if status >= 500} == {}
    assert {"/jobs", "/scanners/example", "/calibrations/example/report"} <= statuses.keys()
