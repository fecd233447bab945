"""Check of restored rows by the contracts of the service's answers, so that every restored row can be returned."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, TypeAdapter, ValidationError
from sqlalchemy import inspect, select, type_coerce
from sqlalchemy.exc import NoResultFound
from sqlalchemy.orm import Session
from sqlalchemy.types import NullType

from sawmill_platform.backups.manifest import ROWS
from sawmill_platform.backups.rows import line_of
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.base import placed_complaint
from sawmill_platform.contracts.events import Event
from sawmill_platform.database.tables import (
    Base,
    DeliveryRow,
    EventClass,
    EventRow,
    JobDependencyRow,
    JobRow,
    KeyRow,
    RepeatRow,
    SenderRow,
    UploadRow,
    WebhookRow,
)
from sawmill_platform.errors import Damaged, Invalid
from sawmill_platform.jobs.job_store import read_job
from sawmill_platform.keys.key_store import read_key
from sawmill_platform.keys.repeats import KeptAnswer, KeptRequest, read_kept
from sawmill_platform.ledger.audit import read_audit_entry
from sawmill_platform.ledger.event_reader import read_event
from sawmill_platform.uploads.upload_store import read_upload
from sawmill_platform.webhooks.webhook_store import read_delivery, read_webhook

_BATCH = 500
# Errors of reading a row with a value that does not fit. A database that does not answer raises other errors.
_UNFIT = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError, NoResultFound, Invalid)
_ANSWER = TypeAdapter(KeptAnswer)
_OF_CLOCKS = {event_kinds.CLOCK_OFF, event_kinds.CLOCK_STEPPED}

Read = Callable[[Session, Any], object]
Readers = Mapping[type[Base], Read]
"""For each table, the function that reads a row by its contract, or raises the error of a value that does not fit."""


def refuse_unfit_row(session: Session, folder: Path, readers: Readers) -> None:
    """Read all rows, whose tables are up to date, by their contracts.

    Parameters
    ----------
    folder
        Backup from which the rows came, to find the line of a row.
    readers
        Readers of all tables.

    Raises
    ------
    Damaged
        The service could not return a row.
    """
    for kind, read in readers.items():
        if _refused(session, kind, read, _BATCH) is None:
            continue
        # Loading may refuse a value for a whole batch: the second time rows are loaded one by one.
        number, error = _refused(session, kind, read, 1) or (0, None)
        columns = inspect(kind).primary_key
        keys = select(*(type_coerce(column, NullType()).label(column.name) for column in columns)).order_by(*columns)
        key = dict(session.execute(keys.offset(number).limit(1)).mappings().one())
        line = line_of(folder, kind.__tablename__, key)
        made = f"the row {key} of {kind.__tablename__}, which was brought up to date,"
        where = made if line is None else f"line {line} of {ROWS}/{kind.__tablename__}.jsonl"
        raise Damaged(f"{where} is refused: {_complaint(error)}") from error


def _refused(session: Session, kind: type[Base], read: Read, batch: int) -> tuple[int, Exception] | None:
    """Read a table in the order of keys; return the number of rows before the first refused row, and its error."""
    rows = select(kind).order_by(*inspect(kind).primary_key).execution_options(yield_per=batch)
    number = 0
    try:
        for row in session.scalars(rows):
            answer = read(session, row)
            if isinstance(answer, BaseModel):
                answer.model_dump_json()  # some texts and nested values can be read and not be written
            number += 1
    except _UNFIT as error:
        return number, error
    return None


def _complaint(error: Exception | None) -> str:
    if isinstance(error, ValidationError):
        return f"{placed_complaint(error)}, not {error.errors()[0]['input']!r:.100}"
    return f"it lacks {error}" if isinstance(error, KeyError) else " ".join(str(error).split())


class _DetailOfAttempt(BaseModel, strict=True):
    """Fields that pages show of the detail of a job's event."""

    peak_memory_bytes: int = 0


class _DetailOfClock(BaseModel, strict=True):
    """Fields that pages show of the detail of a clock's event."""

    off_s: float


def read_any_event(_: Session, row: EventRow) -> Event:
    """Read an event, with what the audit and pages show of it."""
    shown = _DetailOfClock if row.what in _OF_CLOCKS else _DetailOfAttempt
    shown.model_validate(row.detail or {})
    if row.event_class is EventClass.DECISION:
        read_audit_entry(row)
    return read_event(row)


def _read_repeat(_: Session, row: RepeatRow) -> KeptRequest:
    _ANSWER.validate_python(row.answer)
    return read_kept(row)


def loaded(_: Session, row: Base) -> Base:
    """Return a loaded row: loading has checked its columns and foreign keys, and there is no further contract."""
    return row


OF_THE_SERVICE: Readers = {
    JobRow: lambda _, row: read_job(row),
    JobDependencyRow: loaded,
    EventRow: read_any_event,
    UploadRow: lambda _, row: read_upload(row),
    KeyRow: lambda _, row: read_key(row),
    WebhookRow: read_webhook,
    DeliveryRow: lambda _, row: read_delivery(row),
    SenderRow: loaded,
    RepeatRow: _read_repeat,
}
"""Readers of the tables of the job service."""
