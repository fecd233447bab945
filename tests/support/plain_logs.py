"""The logs of tests without frames and variables, and the SQL statements that a test compiles."""

from typing import Any

import structlog
from sqlalchemy import Engine
from sqlalchemy.engine.default import DefaultDialect
from sqlalchemy.util import LRUCache

from sawmill_platform.database import engines


def log_plainly() -> None:
    """Tracebacks as Python writes them: one drawn in boxes with every variable takes structlog ten seconds."""
    rendered = structlog.dev.ConsoleRenderer(colors=False, exception_formatter=structlog.dev.plain_traceback)
    added = [structlog.contextvars.merge_contextvars, structlog.processors.add_log_level]
    structlog.reset_defaults()
    structlog.configure(processors=[*added, rendered])


# Of the whole product and its tests there are fewer.
KEPT = 5_000


def share_compiled_statements() -> None:
    """For all engines made from now on: SQLAlchemy keeps compiled statements by dialect, one of each engine."""
    shared: LRUCache[Any, Any] = LRUCache(KEPT)
    create_engine = engines.create_engine

    def create(*arguments: Any, **options: Any) -> Engine:
        engine = create_engine(*arguments, **options)
        engine.update_execution_options(compiled_cache=shared)
        return engine

    def equal(one: DefaultDialect, other: object) -> bool:
        return type(one) is type(other) and one.server_version_info == other.server_version_info

    engines.create_engine = create
    DefaultDialect.__eq__ = equal
    DefaultDialect.__hash__ = lambda dialect: hash(type(dialect))
