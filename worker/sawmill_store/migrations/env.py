"""Alembic's entry; the connection and its transaction belong to `Database.upgrade`."""

from alembic import context

import sawmill_store.mill_tables  # noqa: F401 - its rows are part of the metadata
from sawmill_platform.database.tables import Base

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=Base.metadata,
    render_as_batch=True,
    compare_type=True,
)
context.run_migrations()
