"""What happened to each job by triggers in the transactions that change the rows, whatever the product counts."""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import Connection, Engine, MetaData, create_engine, text

ENDS = "('succeeded', 'failed', 'cancelled')"
PUBLISHED = {"scans": "reading"} | dict.fromkeys(
    ("calibrations", "reconstructions", "drifts", "plans", "asked"), "result"
)
TEMPORARY = ("attempts", "incoming", "removed")


@dataclass(frozen=True)
class Ledger:
    states: dict[str, str]
    losses: int
    doubles: list[str]
    known: frozenset[str]


class Audit:
    """A connection of the harness's own to the database of a run."""

    def __init__(self, url: str) -> None:
        options = {"timeout": 30} if url.startswith("sqlite") else {"connect_timeout": 5}
        self._engine: Engine = create_engine(url, connect_args=options, pool_pre_ping=True)

    def install(self) -> None:
        """Make the triggers. A migration that rebuilds a table drops them, so call this when the service is up."""
        with self._engine.begin() as connection:
            for statement in self._statements():
                connection.execute(text(statement))

    def unfinished(self) -> int:
        with self.reading() as connection:
            return int(connection.scalar(text(f"SELECT count(*) FROM jobs WHERE state NOT IN {ENDS}")) or 0)  # noqa: S608

    def holders(self) -> list[int]:
        """List the process ids of the workers that run a job at this moment."""
        with self.reading() as connection:
            names = connection.scalars(text("SELECT worker FROM jobs WHERE state = 'running'")).all()
            endings = [name.rpartition("-")[2] for name in names if name]
            return [int(ending) for ending in endings if ending.isdigit()]

    def ledger(self) -> Ledger:
        with self.reading() as connection:
            rows = connection.execute(text("SELECT id, state, losses FROM jobs")).all()
            states, losses = {row.id: row.state for row in rows}, sum(row.losses for row in rows)
            noted = connection.execute(text("SELECT what, id FROM faults_audit")).all()
            counted = Counter((row.what, row.id) for row in noted).items()
            doubles = [f"{what} {identifier}: {times} times" for (what, identifier), times in counted if times > 1]
            return Ledger(states, losses, doubles, _all_ids(connection))

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        with self._engine.connect() as connection:
            yield connection

    def close(self) -> None:
        self._engine.dispose()

    def _statements(self) -> Iterator[str]:
        sqlite = self._engine.dialect.name == "sqlite"
        yield "CREATE TABLE IF NOT EXISTS faults_audit (what VARCHAR(20), id VARCHAR(64))"
        if not sqlite:
            yield (
                "CREATE OR REPLACE FUNCTION faults_note() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN "
                "INSERT INTO faults_audit VALUES (TG_ARGV[0], NEW.id); RETURN NULL; END $$"
            )
        watched = [("jobs", "state", f"NEW.state IN {ENDS} AND OLD.state <> NEW.state")]
        watched += [(name, column, f"NEW.{column} IS NOT NULL") for name, column in PUBLISHED.items()]
        for table, column, when in watched:
            what = "ended" if table == "jobs" else table
            head = f"TRIGGER {'IF NOT EXISTS ' if sqlite else ''}faults_{table} AFTER UPDATE OF {column} ON {table}"
            if sqlite:
                yield f"CREATE {head} WHEN {when} BEGIN INSERT INTO faults_audit VALUES ('{what}', NEW.id); END"  # noqa: S608
            else:
                yield (f"CREATE OR REPLACE {head} FOR EACH ROW WHEN ({when}) EXECUTE FUNCTION faults_note('{what}')")


def orphans(data: Path, known: frozenset[str]) -> list[str]:
    """List the files and folders that no row knows, once nothing runs; `numba-cache` holds compiled kernels."""
    folders = {path.name: path for path in data.iterdir() if path.is_dir()}
    found = [path for name in TEMPORARY for path in _in(data / name)]
    owned = [path for name, path in folders.items() if name not in {*TEMPORARY, "uploads", "numba-cache"}]
    for folder in [*owned, *_in(data / "uploads")]:
        found += [path for path in _in(folder) if path.name not in known]
    return sorted(str(path.relative_to(data)) for path in found)


def _in(folder: Path) -> list[Path]:
    return list(folder.iterdir()) if folder.is_dir() else []


def _all_ids(connection: Connection) -> frozenset[str]:
    tables = MetaData()
    tables.reflect(connection)
    found: set[str] = set()
    for table in tables.sorted_tables:
        if "id" in table.columns and not table.name.startswith("faults_"):
            found |= set(map(str, connection.scalars(table.select().with_only_columns(table.c.id))))
    return frozenset(found)
