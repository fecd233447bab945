"""Copies of a template database that are emptied after each test: to make one takes several times as long."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

import pytest
from postgres_server import PostgresDatabases

from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store

ARCHIVE = Path(__file__).with_name("data_0_1_0.tar.xz")


sqlite_alone = pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
postgresql_alone = pytest.mark.parametrize("database_url", ["postgresql"], indirect=True)


END_OTHERS = """
SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = current_database() AND pid <> pg_backend_pid()
"""
# Tables, indexes and sequences with their columns, and how many of what else a migration makes.
SHAPE = """
SELECT (SELECT string_agg(concat_ws(' ', relname, attname, atttypid, attnotnull), ',' ORDER BY relname, attnum)
        FROM pg_class c JOIN pg_attribute a ON a.attrelid = c.oid
        WHERE c.relnamespace = 'public'::regnamespace AND NOT a.attisdropped),
       (SELECT count(*) FROM pg_constraint), (SELECT count(*) FROM pg_trigger WHERE NOT tgisinternal),
       (SELECT count(*) FROM pg_proc WHERE pronamespace = 'public'::regnamespace)
"""
TABLES = "SELECT tablename FROM pg_tables WHERE schemaname = %s"
FROM_THE_FIRST = "SELECT setval(format('%I', sequencename)::regclass, start_value, false) FROM pg_sequences"


class EmptiedDatabases:
    """One at a time, with all tables and the built-in phantoms; the empty data folder goes with them."""

    def __init__(self, server: PostgresDatabases, data: Path) -> None:
        self._server, self._template = server, f"template_{uuid4().hex}"
        self.data = data
        self._free: list[str] = []
        server.run(f"CREATE DATABASE {self._template}")
        Store.open(StorageSettings(data_folder=data, database_url=server.url(self._template))).close()
        with server.connected(self._template) as connection:
            self._tables = [name for (name,) in connection.execute(TABLES, ("public",))]
            connection.execute("CREATE SCHEMA at_first")
            for name in self._tables:
                if connection.execute(f'TABLE "{name}" LIMIT 1').fetchone():
                    connection.execute(f'CREATE TABLE at_first."{name}" AS TABLE "{name}"')
            self._filled = [name for (name,) in connection.execute(TABLES, ("at_first",))]
            self._shape = connection.execute(SHAPE).fetchone()

    @contextmanager
    def one(self) -> Iterator[str]:
        """The URL of a database as the template was."""
        if not self._free:
            self._free.append(f"test_{uuid4().hex}")
            self._server.run(f"CREATE DATABASE {self._free[-1]} TEMPLATE {self._template} STRATEGY file_copy")
        name = self._free.pop()
        yield self._server.url(name)
        if self._emptied(name):
            self._free.append(name)
        else:
            self._server.run(f"DROP DATABASE {name} WITH (FORCE)")

    def _emptied(self, name: str) -> bool:
        """Whether it is as the template again; one whose tables were changed is not."""
        with self._server.connected(name) as connection:
            connection.execute(END_OTHERS)
            if connection.execute(SHAPE).fetchone() != self._shape:
                return False
            with connection.transaction():
                connection.execute("SET LOCAL session_replication_role = replica")  # no order of references
                for table in self._tables:
                    connection.execute(f'DELETE FROM "{table}"')  # noqa: S608 - a name of ours
                for table in self._filled:
                    connection.execute(f'INSERT INTO "{table}" TABLE at_first."{table}"')
                connection.execute(FROM_THE_FIRST)
        return True
