"""Requests that a job answers: one store for every declared kind.

The rows of a kind are in the table `asked`. The four kinds of the first versions keep tables of their own, so that no
stored row had to move: `mill_tables.OWN_TABLES` names them.
"""

from collections.abc import Collection, Mapping
from datetime import datetime
from types import MappingProxyType
from typing import Any, Generic

from sqlalchemy import Select, select
from sqlalchemy.orm import Session

from sawmill_contracts.kinds import Answer, Ask, AskedKind
from sawmill_contracts.row_ranges import parse_rows
from sawmill_contracts.scans import ScanShape
from sawmill_platform.contracts.base import Contract, Page
from sawmill_platform.contracts.jobs import JobState, Priority
from sawmill_platform.database.database import Database
from sawmill_platform.database.paging import created_between, narrowed, new_id, read_page, refuse_taken
from sawmill_platform.database.tables import JobRow
from sawmill_platform.errors import Invalid
from sawmill_platform.jobs.queue_limits import Places, queue_job
from sawmill_store import mill_tables
from sawmill_store.mill_files import MillFiles
from sawmill_store.queuing import QueuingPart
from sawmill_store.requests.references import found_asked, looked_up, read_asked

NOTHING: Mapping[str, str] = MappingProxyType({})


class Asked(QueuingPart, Generic[Ask, Answer]):
    """Store of the requests of one kind.

    Parameters
    ----------
    database, files, places
        Database of the rows, files that jobs leave, and the limit of waiting jobs.
    declared
        Declaration of the kind.
    """

    def __init__(self, database: Database, files: MillFiles, places: Places, declared: AskedKind[Ask, Answer]) -> None:
        super().__init__(database, files, places)
        self._declared = declared

    def accept(
        self,
        ask: Ask,
        *,
        identifier: str | None = None,
        job_id: str | None = None,
        priority: Priority = Priority.INTERACTIVE,
        given: Mapping[str, str] = NOTHING,
    ) -> Answer:
        """Write a request and queue its job, which waits for the unfinished jobs that the request refers to.

        Parameters
        ----------
        ask
            The request.
        identifier, job_id
            Fixed ids; null for new ones.
        priority
            Priority of the job in the queue.
        given
            References that the request itself does not have, by the names of their columns, such as `phantom_id`.

        Raises
        ------
        NotFound
            A reference names nothing that exists.
        Conflict
            A referenced row cannot be used, a required reference is missing, or an id is taken.
        Invalid
            The scan has been read, and lacks requested rows or views.
        QueueFull
            The allowed number of jobs is waiting already.
        """
        with self._database.write() as session:
            row = self.queue(
                session, ask, self._database.now(), identifier=identifier, job_id=job_id, priority=priority, given=given
            )
            _refuse_beyond_scan(session, row, ask)
            return self._read(row)

    def queue(
        self,
        session: Session,
        ask: Ask,
        now: datetime,
        *,
        identifier: str | None = None,
        job_id: str | None = None,
        priority: Priority = Priority.INTERACTIVE,
        given: Mapping[str, str] = NOTHING,
    ) -> mill_tables.Answered:
        """Write a row and its job inside the caller's transaction; the rest is as in `accept`."""
        declared = self._declared
        table, identifier = mill_tables.table_of(declared.kind), identifier or new_id()
        refuse_taken(session, table, declared.noun, identifier)
        fields, needs = looked_up(session, declared.references, ask.model_dump(mode="json") | dict(given), now)
        options = declared.options.model_validate(
            {name: fields[name] for name in declared.options.model_fields if name in fields}
        )
        job = queue_job(
            session,
            declared.kind,
            identifier,
            now,
            short=declared.is_short(options),
            group_id=fields.get("scanner_id"),
            needs=needs,
            job_id=job_id,
            priority=priority,
        )
        row = table(
            id=identifier,
            created_at=now,
            options=options.model_dump(mode="json"),
            job_id=job.id,
            **{name: fields[name] for name in table.own_columns() if name in fields},
        )
        session.add(row)
        session.flush()
        session.refresh(row, ["job"])
        self._places.take(session, job)
        return row

    def get(self, identifier: str) -> Answer:
        """Return a request with its answer, or raise `NotFound`."""
        with self._database.read() as session:
            return self._read(found_asked(session, self._declared, identifier))

    def page(
        self,
        *,
        state: JobState | None = None,
        created_from: datetime | None = None,
        created_before: datetime | None = None,
        after: str | None = None,
        limit: int = 50,
        **references: str | None,
    ) -> Page[Answer]:
        """Return a page, newest first, by state, span of time and ids of references such as `scan_id`; null: any."""
        table = mill_tables.table_of(self._declared.kind)
        columns = {getattr(table, name): identifier for name, identifier in references.items()}
        statement = narrowed(_rows(self._declared, state), columns)
        statement = created_between(statement, table, created_from, created_before)
        with self._database.read() as session:
            return read_page(session, statement, table, self._read, after=after, limit=limit)

    def several(self, identifiers: Collection[str]) -> dict[str, Answer]:
        """Return the requests of these ids that exist, by id."""
        statement = _rows(self._declared).where(mill_tables.table_of(self._declared.kind).id.in_(identifiers))
        with self._database.read() as session:
            return {row.id: self._read(row) for row in session.scalars(statement)}

    def _read(self, row: mill_tables.Answered) -> Answer:
        return read_asked(self._declared, row)


def _rows(declared: AskedKind[Any, Any], state: JobState | None = None) -> Select[Any]:
    """Select the rows of a kind, in any state or in one; jobs are joined only where needed."""
    table = mill_tables.table_of(declared.kind)
    kind = None if declared.kind in mill_tables.OWN_TABLES else declared.kind
    statement = select(table) if kind is None and state is None else select(table).join(table.job)
    return narrowed(statement, {JobRow.kind: kind, JobRow.state: state})


def _refuse_beyond_scan(session: Session, row: mill_tables.Answered, ask: Contract) -> None:
    """Refuse rows and views that the scan does not have; the job checks a scan that has not been read yet."""
    scan_id = getattr(row, "scan_id", None)
    scan = None if scan_id is None else session.get(mill_tables.ScanRow, scan_id)
    if scan is None or scan.reading is None:
        return
    shape = ScanShape.model_validate(scan.reading["shape"])
    for name in ("rows", "log_rows"):
        rows = getattr(ask, name, None)
        if rows is not None and parse_rows(rows).stop > shape.rows:
            raise Invalid("rows-outside", f"{name} is {rows}, but scan {scan.id!r} has rows 0:{shape.rows} only")
    views = getattr(ask, "views", None)
    if views is not None and views > shape.views:
        raise Invalid("views-too-many", f"views is {views}, but scan {scan.id!r} has {shape.views}")
