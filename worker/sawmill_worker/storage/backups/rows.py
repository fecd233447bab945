"""Rows as JSON, a line each: the same from SQLite and PostgreSQL, so that either can be restored to the other.

Tables are read and written as the database has them, whatever its revision: not as this version of the software does.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from datetime import date, datetime
from itertools import islice
from pathlib import Path
from typing import Any

from sqlalchemy import JSON, Column, Connection, Date, DateTime, MetaData, insert, inspect, select, text
from sqlalchemy import Table as SqlTable
from sqlalchemy.engine.interfaces import ReflectedColumn
from sqlalchemy.exc import InterfaceError, OperationalError, StatementError
from sqlalchemy.types import TypeEngine

from sawmill_worker.storage.backups.manifest import ROWS, Table, open_plain
from sawmill_worker.storage.errors import Damaged
from sawmill_worker.storage.tables import Base, ClockRow, SessionRow, UtcDateTime

# Logins are not restored, and a clock is its machine's.
LEFT_OUT = {SessionRow.__tablename__, ClockRow.__tablename__}
_BATCH = 500

Row = dict[str, Any]


def write_rows(connection: Connection, folder: Path) -> dict[str, Table]:
    """Write all tables of a transaction that sees one instant.

    Returns
    -------
    dict
        By name of the table: what was written.
    """
    (folder / ROWS).mkdir()
    return {
        table.name: _write(connection, table, folder / ROWS / f"{table.name}.jsonl") for table in _tables(connection)
    }


def read_rows(connection: Connection, folder: Path, tables: Mapping[str, Table]) -> None:
    """Write the rows of a backup into empty tables of its revision.

    Raises
    ------
    Damaged
        A table, a column or a value is none of that revision.
    """
    there = {table.name: table for table in _tables(connection)}
    for name in tables.keys() - there.keys():
        raise Damaged(f"{ROWS}/{name}.jsonl is of no table of the revision that the backup names")
    for table in there.values():
        if table.name in tables:
            _read(connection, table, folder / ROWS / f"{table.name}.jsonl")


def go_on_counting(connection: Connection) -> None:
    """Have PostgreSQL number new rows behind those that are there; SQLite does by itself."""
    if connection.dialect.name == "sqlite":
        return
    for table in Base.metadata.sorted_tables:
        if (column := table.autoincrement_column) is not None:
            last = f"SELECT setval(pg_get_serial_sequence('{table.name}', '{column.name}'), max({column.name}))"
            connection.execute(text(f"{last} FROM {table.name}"))


def _tables(connection: Connection) -> Sequence[SqlTable]:
    """Ours that are there, those first that others refer to; of columns alone, without indexes and constraints."""
    inspector = inspect(connection)
    keys, columns = inspector.get_multi_pk_constraint(), inspector.get_multi_columns()
    ours = Base.metadata.tables.keys() - LEFT_OUT
    names = [name for name, _ in inspector.get_sorted_table_and_fkc_names() if name is not None and name in ours]

    def column(name: str, found: ReflectedColumn) -> Column[Any]:
        is_key = found["name"] in keys[None, name]["constrained_columns"]
        return Column(found["name"], _as_stored(found["type"]), primary_key=is_key)

    return [SqlTable(name, MetaData(), *(column(name, found) for found in columns[None, name])) for name in names]


def _as_stored(kind: TypeEngine[Any]) -> TypeEngine[Any]:
    """As `storage.tables` has them: times in UTC, and no JSON is no `null`."""
    if isinstance(kind, DateTime):
        return UtcDateTime()
    return JSON(none_as_null=True) if isinstance(kind, JSON) else kind


def _write(connection: Connection, table: SqlTable, path: Path) -> Table:
    rows = size_bytes = 0
    sum_so_far = hashlib.sha256()
    found = connection.execution_options(yield_per=_BATCH).execute(select(table).order_by(*table.primary_key))
    names, encode = list(found.keys()), json.JSONEncoder(default=_time).encode
    with path.open("xb") as file:
        for row in found:
            line = encode(dict(zip(names, row, strict=True))).encode() + b"\n"
            file.write(line)
            sum_so_far.update(line)
            rows, size_bytes = rows + 1, size_bytes + len(line)
    return Table(rows=rows, size_bytes=size_bytes, sha256=sum_so_far.hexdigest())


def _read(connection: Connection, table: SqlTable, path: Path) -> None:
    try:
        rows = _rows(table, path)
        while batch := list(islice(rows, _BATCH)):
            connection.execute(insert(table), batch)
    except (OperationalError, InterfaceError):
        raise  # of the database, whatever the row
    except StatementError as error:
        reason = " ".join(str(getattr(error, "orig", None) or error).split())
        raise Damaged(f"the database refuses a row of {ROWS}/{path.name}: {reason}") from error


def _rows(table: SqlTable, path: Path) -> Iterator[Row]:
    columns = {column.name: column.type for column in table.columns}
    with open_plain(path) as file:
        for number, line in enumerate(file, 1):
            try:
                row = json.loads(line)
                if not isinstance(row, dict) or row.keys() != columns.keys():
                    raise ValueError("its columns are not those of the table")  # noqa: TRY301 - as a wrong value
                yield {name: _value(columns[name], value) for name, value in row.items()}
            except (ValueError, TypeError, RecursionError) as error:
                raise Damaged(f"line {number} of {ROWS}/{path.name} is no row: {error}") from error


def _value(kind: TypeEngine[Any], value: Any) -> Any:  # noqa: ANN401 - of any column
    if value is None or isinstance(kind, JSON):
        return value
    if isinstance(kind, UtcDateTime):
        return datetime.fromisoformat(value)
    return date.fromisoformat(value) if isinstance(kind, Date) else value


def _time(value: object) -> str:
    if isinstance(value, date):  # or a time
        return value.isoformat()
    msg = f"a value of the type {type(value).__name__} has no form in a backup"
    raise TypeError(msg)
