"""Let all engines of a process share compiled statements: SQLAlchemy keeps them by dialect, one of each engine."""

from typing import Any

from sqlalchemy import Engine
from sqlalchemy.engine.default import DefaultDialect
from sqlalchemy.util import LRUCache

from sawmill_platform.database import engines

# Of the whole product and its tests there are fewer.
KEPT = 5_000


def share_compiled_statements() -> None:
    """For all engines that this process makes from now on."""
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
