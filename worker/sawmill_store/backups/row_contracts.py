"""Check of restored rows by the contracts of the service's answers, so that every restored row can be returned."""

from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pydantic import BaseModel, TypeAdapter, ValidationError
from sqlalchemy import inspect, select, type_coerce
from sqlalchemy.exc import NoResultFound
from sqlalchemy.orm import Session
from sqlalchemy.types import NullType

from sawmill_contracts import job_kinds
from sawmill_contracts.alarms import Alarm
from sawmill_contracts.kinds import AskedKind
from sawmill_contracts.phantoms import PhantomState, StoredPhantom
from sawmill_contracts.scanner_drift import PooledDrift
from sawmill_contracts.scans import Scan, ScanState
from sawmill_contracts.schedules import Schedule
from sawmill_mill.alarms import ALARMS
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.base import placed_complaint
from sawmill_platform.contracts.events import Event
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.contracts.kinds import declaration_of
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
from sawmill_platform.due_times import next_due
from sawmill_platform.errors import Damaged, Invalid
from sawmill_platform.jobs.job_store import read_job
from sawmill_platform.keys.key_store import read_key
from sawmill_platform.keys.repeats import KeptAnswer, KeptRequest, read_kept
from sawmill_platform.ledger.audit import read_audit_entry
from sawmill_platform.ledger.event_reader import read_event
from sawmill_platform.uploads.upload_store import read_upload
from sawmill_platform.webhooks.webhook_store import read_delivery, read_webhook
from sawmill_store.alarms import read_alarm
from sawmill_store.backups.manifest import ROWS
from sawmill_store.backups.rows import line_of
from sawmill_store.drift_charts import read_chart
from sawmill_store.history import read_entry
from sawmill_store.measurements import read_measurement
from sawmill_store.phantoms import picture_of, read_phantom
from sawmill_store.requests.asked_rows import read_asked
from sawmill_store.retention.retention_store import read_retention
from sawmill_store.scanners import read_scanner
from sawmill_store.scans import read_scan
from sawmill_store.schedules import read_schedule, read_schedule_run
from sawmill_store.tables import (
    ActivationRow,
    AlarmRow,
    Answered,
    AskedRow,
    CalibrationRow,
    DriftChartRow,
    DriftRow,
    MeasurementRow,
    PhantomRow,
    PlanRow,
    ReconstructionRow,
    RetentionRow,
    ScannerRow,
    ScanRow,
    ScheduleRow,
    ScheduleRunRow,
    table_of,
)

_BATCH = 500
# Errors of reading a row with a value that does not fit. A database that does not answer raises other errors.
_UNFIT = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError, NoResultFound, Invalid)
_OBJECT = TypeAdapter(dict[str, object])
_ANSWER = TypeAdapter(KeptAnswer)
_OF_CLOCKS = {event_kinds.CLOCK_OFF, event_kinds.CLOCK_STEPPED}

Read = Callable[[Session, Any], object]


def refuse_unfit_row(session: Session, folder: Path) -> None:
    """Read all rows, whose tables are up to date, by their contracts.

    Parameters
    ----------
    folder
        Backup from which the rows came, to find the line of a row.

    Raises
    ------
    Damaged
        The service could not return a row.
    """
    for kind, read in READ.items():
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


def _read_event(_: Session, row: EventRow) -> Event:
    shown = _DetailOfClock if row.what in _OF_CLOCKS else _DetailOfAttempt
    shown.model_validate(row.detail or {})
    if row.event_class is EventClass.DECISION:
        read_audit_entry(row)
    if row.topic is not None:
        read_entry(row, None, stored=False)
    return read_event(row)


def _read_scan(_: Session, row: ScanRow) -> Scan:
    _check_result(row.state is ScanState.READY, row.reading)
    if row.reading is not None:
        declaration_of(job_kinds.INGEST).result.model_validate(row.reading)
    return read_scan(row)


def _read_phantom(_: Session, row: PhantomRow) -> StoredPhantom:
    _check_result(row.state is PhantomState.READY, row.drawing)
    if row.picture is not None:
        picture_of(row)
    return read_phantom(row)


def _read_asked(_: Session, row: Answered) -> object:
    declared = declaration_of(row.job.kind)
    if not isinstance(declared, AskedKind) or not isinstance(row, table_of(declared.kind)):
        msg = f"job_id: {row.job_id!r} is a job of the kind {row.job.kind}"
        raise TypeError(msg)
    if row.job.subject_id != row.id:
        msg = f"job_id: {row.job_id!r} is a job of {row.job.subject_id!r}"
        raise ValueError(msg)
    _check_result(row.job.state is JobState.SUCCEEDED, row.result)
    declared.options.model_validate(row.options)
    return read_asked(declared, row)


def _check_result(has_succeeded: bool, result: object) -> None:  # noqa: FBT001 - the first of two
    if has_succeeded != (result is not None):
        msg = "its job has succeeded, and it has no result" if has_succeeded else "it has a result without a success"
        raise ValueError(msg)


def _read_alarm(_: Session, row: AlarmRow) -> Alarm:
    for name in ALARMS[row.what].fields:
        if getattr(row, name) is None:
            msg = f"{name}: an alarm {row.what} has one, not null"
            raise ValueError(msg)
    return read_alarm(row)


def _read_chart(session: Session, row: DriftChartRow) -> PooledDrift:
    _OBJECT.validate_python(row.state)
    if row.alarm is not None:
        datetime.fromisoformat(row.alarm["at"])
    return read_chart(session, row)


def _read_schedule(session: Session, row: ScheduleRow) -> Schedule:
    next_due(row.cron, row.time_zone, row.created_at)
    return read_schedule(session, row)


def _read_repeat(_: Session, row: RepeatRow) -> KeptRequest:
    _ANSWER.validate_python(row.answer)
    return read_kept(row)


def _load(_: Session, row: Base) -> Base:
    """Return a loaded row: loading has checked its columns and foreign keys, and there is no further contract."""
    return row


READ: Mapping[type[Base], Read] = MappingProxyType(
    {
        JobRow: lambda _, row: read_job(row),
        JobDependencyRow: _load,
        EventRow: _read_event,
        ScannerRow: read_scanner,
        PhantomRow: _read_phantom,
        ScanRow: _read_scan,
        UploadRow: lambda _, row: read_upload(row),
        **dict.fromkeys((AskedRow, CalibrationRow, ReconstructionRow, DriftRow, PlanRow), _read_asked),
        ActivationRow: _load,
        MeasurementRow: lambda _, row: read_measurement(row),
        DriftChartRow: _read_chart,
        ScheduleRow: _read_schedule,
        ScheduleRunRow: lambda _, row: read_schedule_run(row),
        AlarmRow: _read_alarm,
        RetentionRow: lambda _, row: read_retention(row, row.changed_at),
        KeyRow: lambda _, row: read_key(row),
        WebhookRow: read_webhook,
        DeliveryRow: lambda _, row: read_delivery(row),
        SenderRow: _load,
        RepeatRow: _read_repeat,
    }
)
