"""Engines on SQLite and PostgreSQL: number of connections, and time limits for an answer."""

import sqlite3
from pathlib import Path
from typing import Any

from sqlalchemy import URL, Connection, Engine, create_engine, event, make_url
from sqlalchemy.exc import ArgumentError

from sawmill_platform.errors import StorageMisconfigured

# A request that has to write answers within five seconds, and may wait only this long for the lock: the rest is reserve
# for a machine whose cores are all busy.
_BUSY_TIMEOUT_MS = 2_500
_KEPT_CONNECTIONS = 10
# One for each of the API's threads, of which FastAPI has 40, and one for a thread that reads the time.
_MOST_CONNECTIONS = 41
_POOL_WAIT_S = 3.0
_POSTGRESQL = {"postgresql", "postgres", "postgresql+psycopg"}
_FORMS = "sqlite:////path/to/file or postgresql://user:password@host/database"


def make_engine(url: str, password_file: Path | None = None) -> Engine:
    """Return an engine whose transactions give up in a few seconds, and whose writes are serialised on SQLite."""
    parsed = _parsed(url)
    if password_file is not None:
        parsed = _with_password(parsed, password_file)
    # A statement's values, which include other people's data, are kept out of error messages, and so out of logs.
    options = {"pool_size": _KEPT_CONNECTIONS, "pool_timeout": _POOL_WAIT_S, "hide_parameters": True}
    if parsed.drivername in _POSTGRESQL:
        return _on_postgresql(parsed.set(drivername="postgresql+psycopg"), options)
    # Without a limit on connections, the pool has at most one for each of the process's threads.
    engine = create_engine(parsed, max_overflow=-1, **options)
    event.listen(engine, "connect", _configure_sqlite)
    event.listen(engine, "begin", _begin_sqlite)
    return engine


def _parsed(url: str) -> URL:
    try:
        parsed = make_url(url)
    except ArgumentError as error:  # a URL may hold a password, so it is not repeated
        raise StorageMisconfigured(f"SAWMILL_DATABASE_URL is no URL of a database; give {_FORMS}") from error
    if parsed.drivername not in {"sqlite", *_POSTGRESQL}:
        msg = f"SAWMILL_DATABASE_URL must begin with sqlite: or postgresql:, not {parsed.drivername!r}; give {_FORMS}"
        raise StorageMisconfigured(msg)
    return parsed


def _with_password(url: URL, file: Path) -> URL:
    if url.drivername not in _POSTGRESQL or url.password is not None:
        raise StorageMisconfigured(
            "SAWMILL_DATABASE_PASSWORD_FILE goes with a SAWMILL_DATABASE_URL without a password, as in "
            "postgresql://user@host/database"
        )
    try:
        password = file.read_text().rstrip("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise StorageMisconfigured(f"SAWMILL_DATABASE_PASSWORD_FILE cannot be read: {error}") from error
    if not password:
        raise StorageMisconfigured(f"SAWMILL_DATABASE_PASSWORD_FILE holds no password: {file} is empty")
    return url.set(password=password)


def _on_postgresql(url: URL, options: dict[str, Any]) -> Engine:
    try:
        from sawmill_platform.database.postgresql import make_patient  # noqa: PLC0415 - the driver is an extra
    except ImportError as error:
        msg = f"PostgreSQL needs its driver ({error}): pip install 'sawmill-calibration[postgresql]'"
        raise StorageMisconfigured(msg) from error
    engine = create_engine(url, max_overflow=_MOST_CONNECTIONS - _KEPT_CONNECTIONS, **options)
    make_patient(engine)
    return engine


def _configure_sqlite(connection: sqlite3.Connection, _: object) -> None:
    connection.isolation_level = None  # `begin` below decides how a transaction starts, not the driver
    for pragma in (
        f"busy_timeout={_BUSY_TIMEOUT_MS}",
        "journal_mode=WAL",
        "synchronous=FULL",
        "foreign_keys=ON",
    ):
        connection.execute(f"PRAGMA {pragma}")


def _begin_sqlite(connection: Connection) -> None:
    options = connection.get_execution_options()
    # A reader that turns writer in mid-transaction fails at once with "database is locked", whatever the timeout.
    connection.exec_driver_sql("BEGIN IMMEDIATE" if options.get("writes", False) else "BEGIN")
