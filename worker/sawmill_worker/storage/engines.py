"""Connections to SQLite and PostgreSQL: how many there are, and how long one waits for an answer."""

import sqlite3

from sqlalchemy import Connection, Engine, create_engine, event

# A request that has to write answers within five seconds, and it may wait for this alone.
_BUSY_TIMEOUT_MS = 3_000
_KEPT_CONNECTIONS = 10


def make_engine(url: str) -> Engine:
    """An engine whose write transactions are serialised where the database is SQLite."""
    # Without a limit of its own, the pool has one connection at most for each of the process's threads: none waits.
    engine = create_engine(
        url, pool_size=_KEPT_CONNECTIONS, max_overflow=-1, pool_pre_ping=not url.startswith("sqlite")
    )
    if engine.dialect.name == "sqlite":
        event.listen(engine, "connect", _configure_sqlite)
        event.listen(engine, "begin", _begin_sqlite)
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
    begin = "BEGIN IMMEDIATE" if options.get("writes", False) else "BEGIN"
    if options.get("patient", True):
        connection.exec_driver_sql(begin)
        return
    connection.exec_driver_sql("PRAGMA busy_timeout=0")
    try:
        connection.exec_driver_sql(begin)
    finally:
        connection.exec_driver_sql(f"PRAGMA busy_timeout={_BUSY_TIMEOUT_MS}")
