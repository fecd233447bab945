"""References that keep a scan, a phantom or a scanner from being deleted."""

from collections.abc import Iterator

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from sawmill_contracts.declared_kinds import asked_kinds
from sawmill_platform.contracts.jobs import UNFINISHED
from sawmill_platform.database.tables import JobRow
from sawmill_store.mill_tables import table_of


def kept_by(session: Session, reference: str, identifier: str) -> Iterator[tuple[str, int]]:
    """Yield plural and number of the rows that refer to an id, for each kind that blocks a deletion.

    Parameters
    ----------
    reference
        Column of the id, such as `phantom_id`.
    """
    for declared in asked_kinds():
        table = table_of(declared.kind)
        if declared.blocks_deletion and reference in table.own_columns():
            referring = select(func.count()).select_from(table).join(JobRow, table.job_id == JobRow.id)
            referring = referring.where(JobRow.kind == declared.kind, getattr(table, reference) == identifier)
            yield declared.kind.plural, session.scalar(referring) or 0


def unfinished_job_about(session: Session, scan_id: str) -> str | None:
    """Return the id of a job that needs a scan and has not ended, if there is one."""
    column = "scan_id"
    for table in {table_of(declared.kind): None for declared in asked_kinds()}:
        if column in table.own_columns():
            job = select(JobRow.id).join(table, table.job_id == JobRow.id)
            job = job.where(getattr(table, column) == scan_id, JobRow.state.in_(UNFINISHED))
            busy = session.scalar(job.limit(1))
            if busy is not None:
                return busy
    return None
