"""An upgrade from the tables of 0.1.0 with jobs of every kind queued, one of them running as its worker was killed."""

import json
from datetime import UTC, datetime
from pathlib import Path

from sqlalchemy import Boolean, DateTime, MetaData, Table
from tests.faults.trial import Trial
from tests.faults.work import Accepted, Work, log_scan, phantom_scan

from sawmill_platform.database.database import Database
from sawmill_platform.database.engines import make_engine
from sawmill_store import mill_tables  # noqa: F401 - brings the migrations

REVISION = "0003"
# In tables of that revision, with what `tests.faults.work` asks for; the first is running.
ROWS = Path(__file__).with_name("rows_0003.json")
_PLURALS = {"ingest": "scans", "calibrate": "calibrations", "drift": "drifts", "reconstruct": "reconstructions"}


def before(data: Path, url: str) -> None:
    """Leave a database and uploads as 0.1.0 left them."""
    for name, content in (("phantom-scan", phantom_scan()), ("log-scan", log_scan())):
        upload = data / "uploads" / "scans" / name / "original"
        upload.parent.mkdir(parents=True)
        upload.write_bytes(content)
    engine = make_engine(url)
    Database(engine).upgrade(REVISION)
    with engine.connect().execution_options(writes=True) as connection, connection.begin():
        tables = MetaData()
        tables.reflect(connection)
        for name, records in json.loads(ROWS.read_text()).items():
            insertion = tables.tables[name].insert()
            for record in records:
                row = {key: _typed(tables.tables[name], key, value) for key, value in record.items()}
                connection.execute(insertion, row)
    engine.dispose()


def begin(trial: Trial) -> None:
    """Add the jobs that were accepted before the upgrade: their answers must be the same."""
    for row in json.loads(ROWS.read_text())["jobs"]:
        name = "drift check" if row["subject_id"] == "drift" else row["subject_id"].replace("-", " ")
        work = Work(name, _PLURALS.get(row["kind"], "plans"))
        trial.asker.accepted.append(Accepted(work, row["subject_id"], row["id"]))


def _typed(table: Table, name: str, value: object) -> object:
    column = table.columns[name].type
    if isinstance(column, DateTime):
        moment = datetime.fromisoformat(str(value))
        return moment.replace(tzinfo=UTC) if column.timezone else moment
    return bool(value) if isinstance(column, Boolean) else value
