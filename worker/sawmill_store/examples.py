"""Examples of a new data folder: their ids and names, and their removal."""

from contextlib import suppress
from typing import Any

from sqlalchemy import Delete, and_, delete, or_, select

from sawmill_contracts import mill_events
from sawmill_contracts.declared_kinds import asked_kinds
from sawmill_contracts.scanners import StoredScanner
from sawmill_platform.contracts.jobs import UNFINISHED
from sawmill_platform.database.tables import JobDependencyRow, JobRow
from sawmill_platform.errors import Conflict, NotFound
from sawmill_platform.ledger.events import announce
from sawmill_store.mill_tables import (
    ActivationRow,
    CalibrationRow,
    MeasurementRow,
    ScannerRow,
    ScanRow,
    ScheduleRow,
    table_of,
)
from sawmill_store.scanners.alarms import close_alarms
from sawmill_store.scanners.history import forget_history
from sawmill_store.store import Store

EXAMPLE, SPARE, SPARSE = "example", "example-spare", "example-sparse"
# A calibration of fixed pairs, a log that passed them, and the inspections of their files: no scanner has them.
PAIRS, PAIR_FILES = f"{EXAMPLE}-pairs", (f"{EXAMPLE}-pair-1", f"{EXAMPLE}-pair-2")
LOG, LOG_FILES = f"{EXAMPLE}-log", (f"{EXAMPLE}-log-1", f"{EXAMPLE}-log-2")
# Names of the example scanners by their ids. A scanner that somebody has renamed is no example any more.
SCANNER_NAMES = {identifier: f"{identifier} scanner" for identifier in (EXAMPLE, SPARE)}
_TABLES: tuple[type[Any], ...] = (*dict.fromkeys(table_of(declared.kind) for declared in asked_kinds()), ScanRow)


def is_example(scanner: StoredScanner) -> bool:
    """Return whether a scanner is one of the examples."""
    return SCANNER_NAMES.get(scanner.id) == scanner.name


def remove_examples(store: Store) -> None:
    """Remove the example scanners with everything that was made of their scans, and the example phantom if it is free.

    Files without a row are removed later, as leftovers; the audit stays.

    Raises
    ------
    Conflict
        A job of the examples has not ended.
    """
    now = store.database.now()
    with store.database.write() as session:
        rows = session.scalars(select(ScannerRow).where(ScannerRow.id.in_(SCANNER_NAMES)).with_for_update()).all()
        scanners = [row for row in rows if row.spec["name"] == SCANNER_NAMES[row.id]]
        ids, without_scanner = [row.id for row in scanners], (EXAMPLE, SPARE, PAIRS, *PAIR_FILES, LOG, *LOG_FILES)
        of_examples = {
            table: or_(table.scanner_id.in_(ids), and_(table.scanner_id.is_(None), table.id.in_(without_scanner)))
            for table in _TABLES
        }
        job_ids = [
            job_id
            for table, condition in of_examples.items()
            for job_id in session.scalars(select(table.job_id).where(condition))
        ]
        unfinished = select(JobRow.id).where(JobRow.id.in_(job_ids), JobRow.state.in_(UNFINISHED)).limit(1)
        if (job_id := session.scalar(unfinished)) is not None:
            raise Conflict("scanner-in-use", f"job {job_id!r} of an example has not ended: wait for it, or cancel it")
        waited = or_(JobDependencyRow.job_id.in_(job_ids), JobDependencyRow.needs_job_id.in_(job_ids))
        referring = (table for table in _TABLES if table is not CalibrationRow)
        statements: list[Delete] = [
            *(delete(table).where(table.scanner_id.in_(ids)) for table in (ActivationRow, MeasurementRow, ScheduleRow)),
            *(delete(table).where(of_examples[table]) for table in referring),
            delete(CalibrationRow).where(of_examples[CalibrationRow]),
            delete(JobDependencyRow).where(waited),
            delete(JobRow).where(JobRow.id.in_(job_ids)),
        ]
        for statement in statements:
            session.execute(statement.execution_options(synchronize_session=False))
        for row in scanners:
            close_alarms(session, now, row.id)
            announce(session, now, mill_events.SCANNER_DELETED, "scanner", row.id, group_id=row.id, decided=row.spec)
            session.flush()
            forget_history(session, row.id)
            session.delete(row)
    with suppress(NotFound, Conflict):  # somebody has deleted it, or uses it
        store.phantoms.delete(SPARE)
