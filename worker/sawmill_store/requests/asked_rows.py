"""Rows of requests: finding and reading a row."""

from typing import Any

from sqlalchemy.orm import Session

from sawmill_contracts.kinds import Answer, AskedKind
from sawmill_platform.errors import NotFound
from sawmill_store.mill_tables import Answered, table_of


def found_asked(session: Session, declared: AskedKind[Any, Any], identifier: str) -> Answered:
    """Find the row with this id."""
    row = session.get(table_of(declared.kind), identifier)
    if row is None or row.job.kind is not declared.kind:
        raise NotFound(declared.noun, identifier)
    return row


def read_asked(declared: AskedKind[Any, Answer], row: Answered) -> Answer:
    """Read a row as the answer of the kind, with state and failure of the job."""
    columns = {column.key: getattr(row, column.key) for column in row.__table__.columns}
    of_job = {name: getattr(row.job, name) for name in ("state", "failure")}
    return declared.read(columns | of_job)
