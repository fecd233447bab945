"""Rows as JSON lines: the same from SQLite and PostgreSQL, so that either database can be restored to the other.

Tables are read and written with the columns of the database, whatever its revision, and not with the columns of this
version of the software. `row_contracts` reads the rows by this version, once the tables are up to date.
"""

import hashlib
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import date, datetime
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    Column,
    Connection,
    Date,
    DateTime,
    Float,
    Integer,
    MetaData,
    String,
    insert,
    inspect,
    select,
    text,
)
from sqlalchemy import Table as SqlTable
from sqlalchemy.engine.interfaces import ReflectedColumn
from sqlalchemy.exc import InterfaceError, OperationalError, StatementError
from sqlalchemy.types import TypeEngine

from sawmill_platform.backups.manifest import ROWS, Table, open_plain
from sawmill_platform.database.tables import Base, ClockRow, DataFolderRow, JobTurnRow, SessionRow, UtcDateTime
from sawmill_platform.errors import Damaged

# Logins are not restored, a clock belongs to a machine, a restored folder gets a new identity, and turns start again.
LEFT_OUT = {each.__tablename__ for each in (SessionRow, ClockRow, DataFolderRow, JobTurnRow)}
_BATCH = 500
# Numbers of new rows follow the restored ones, and PostgreSQL has 32 bits for them.
_LARGEST_KEY = 2_000_000_000
# Years in which a day more or less is still a valid date.
_YEARS = range(2, 9999)
_HALF = re.compile("[\ud800-\udfff]")

Row = dict[str, Any]


def write_rows(connection: Connection, folder: Path) -> dict[str, Table]:
    """Write all tables of a transaction that sees one instant.

    Returns
    -------
    dict
        Written rows and sums, by name of the table.
    """
    (folder / ROWS).mkdir()
    return {
        table.name: _write(connection, table, folder / ROWS / f"{table.name}.jsonl") for table in _tables(connection)
    }


def read_rows(connection: Connection, folder: Path, tables: Mapping[str, Table]) -> None:
    """Write the rows of a backup into empty tables of the backup's revision.

    Raises
    ------
    Damaged
        A table, a column or a value does not fit that revision.
    """
    there = {table.name: table for table in _tables(connection)}
    for name in tables.keys() - there.keys():
        raise Damaged(f"{ROWS}/{name}.jsonl is of no table of the revision that the backup names")
    for table in there.values():
        if table.name in tables:
            _read(connection, table, folder / ROWS / f"{table.name}.jsonl")


def go_on_counting(connection: Connection) -> None:
    """Set PostgreSQL's counters behind the numbers of the restored rows; SQLite does so by itself."""
    if connection.dialect.name == "sqlite":
        return
    for table in Base.metadata.sorted_tables:
        if (column := table.autoincrement_column) is not None:
            last = f"SELECT setval(pg_get_serial_sequence('{table.name}', '{column.name}'), max({column.name}))"
            connection.execute(text(f"{last} FROM {table.name}"))


def _tables(connection: Connection) -> Sequence[SqlTable]:
    """Return our existing tables, referenced tables first, with columns alone: no indexes and no constraints."""
    inspector = inspect(connection)
    keys, columns = inspector.get_multi_pk_constraint(), inspector.get_multi_columns()
    ours = Base.metadata.tables.keys() - LEFT_OUT
    names = [name for name, _ in inspector.get_sorted_table_and_fkc_names() if name is not None and name in ours]

    def column(name: str, found: ReflectedColumn) -> Column[Any]:
        is_key = found["name"] in keys[None, name]["constrained_columns"]
        return Column(found["name"], _as_stored(found["type"]), primary_key=is_key)

    return [SqlTable(name, MetaData(), *(column(name, found) for found in columns[None, name])) for name in names]


def _as_stored(kind: TypeEngine[Any]) -> TypeEngine[Any]:
    """Return the column type that `tables` has: times in UTC, and no JSON is NULL, not the JSON value `null`."""
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


def line_of(folder: Path, table: str, key: Mapping[str, object]) -> int | None:
    """Find the line of a row by its primary key; None where the backup has no such row, as of a row made later."""
    path = folder / ROWS / f"{table}.jsonl"
    if not path.exists():
        return None
    with open_plain(path) as file:
        rows = ((number, json.loads(line)) for number, line in enumerate(file, 1))
        return next((number for number, row in rows if all(row.get(name) == key[name] for name in key)), None)


def _read(connection: Connection, table: SqlTable, path: Path) -> None:
    rows = _rows(table, path)
    while batch := list(islice(rows, _BATCH)):
        try:
            with connection.begin_nested():
                connection.execute(insert(table), [row for _, row in batch])
        except (OperationalError, InterfaceError):
            raise  # an error of the database, whatever the row
        except StatementError:
            _refuse_one(connection, table, path, batch)
            raise


def _refuse_one(connection: Connection, table: SqlTable, path: Path, batch: list[tuple[int, Row]]) -> None:
    """Insert the rows of a batch that was refused, one by one, and name the one that the database refuses."""
    for number, row in batch:
        try:
            connection.execute(insert(table), row)
        except StatementError as error:
            reason = " ".join(str(error.orig or error).split())
            raise Damaged(f"the database refuses line {number} of {ROWS}/{path.name}: {reason}") from error


def _rows(table: SqlTable, path: Path) -> Iterator[tuple[int, Row]]:
    """Read the rows of a table with the numbers of their lines."""
    converters = {column.name: _converter(column) for column in table.columns}
    with open_plain(path) as file:
        for number, line in enumerate(file, 1):
            try:
                row = json.loads(line, parse_float=_finite, parse_constant=_finite)
                if not isinstance(row, dict) or row.keys() != converters.keys():
                    raise ValueError("its columns are not those of the table")  # noqa: TRY301 - as a wrong value
                values = {name: None if value is None else converters[name](value) for name, value in row.items()}
            except (ValueError, TypeError, OverflowError, RecursionError) as error:
                raise Damaged(f"line {number} of {ROWS}/{path.name} is no row: {error}") from error
            yield number, values


def _converter(column: Column[Any]) -> Callable[[Any], Any]:
    """Return the function that converts a column's value from JSON to the value for the database."""
    bits = 63 if isinstance(column.type, BigInteger) else 31
    converters: list[tuple[type[TypeEngine[Any]], Callable[[Any], Any]]] = [
        (JSON, lambda value: value),
        (UtcDateTime, partial(_as_time, column.name)),
        (Date, date.fromisoformat),
        (Boolean, partial(_as_type, column.name, (bool,))),
        (Float, partial(_as_type, column.name, (float, int))),
        (Integer, partial(_as_integer, column.name, _LARGEST_KEY if column.primary_key else 2**bits - 1)),
        (String, partial(_as_text, column.name)),
    ]
    return next(converter for kind, converter in converters if isinstance(column.type, kind))


def _as_type(name: str, types: tuple[type, ...], value: object) -> object:
    if type(value) not in types:  # true is an int of Python
        msg = f"{name} must be a {' or a '.join(each.__name__ for each in types)}, not {value!r:.100}"
        raise ValueError(msg)
    return value


def _as_integer(name: str, largest: int, value: object) -> object:
    if type(value) is not int or abs(value) > largest:
        msg = f"{name} must be a whole number of at most {largest}, not {value!r:.100}"
        raise ValueError(msg)
    return value


def _as_text(name: str, value: object) -> object:
    if not isinstance(value, str) or "\0" in value or _HALF.search(value):
        msg = f"{name} must be a text without NUL and half characters, not {value!a:.100}"
        raise ValueError(msg)
    return value


def _as_time(name: str, value: str) -> datetime:
    moment = datetime.fromisoformat(value)
    if moment.tzinfo is None or moment.year not in _YEARS:
        msg = f"{name} must be a time with its offset from the year 2 to the year 9998, not {value!r:.100}"
        raise ValueError(msg)
    return moment


def _finite(text: str) -> float:
    if math.isfinite(value := float(text)):
        return value
    msg = f"{text:.100} is no finite number"
    raise ValueError(msg)


def _time(value: object) -> str:
    if isinstance(value, date):  # or a time
        return value.isoformat()
    msg = f"a value of the type {type(value).__name__} has no form in a backup"
    raise TypeError(msg)
