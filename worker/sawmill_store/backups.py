"""Backups of a mill: the folders in which its rows name files, and the contracts of its rows."""

from datetime import datetime
from functools import partial

from pydantic import TypeAdapter
from sqlalchemy.orm import Session

from sawmill_contracts import job_kinds
from sawmill_contracts.alarms import Alarm
from sawmill_contracts.kinds import AskedKind
from sawmill_contracts.phantoms import PhantomState, StoredPhantom
from sawmill_contracts.scanner_drift import PooledDrift
from sawmill_contracts.scans import Scan, ScanState
from sawmill_contracts.schedules import Schedule
from sawmill_mill.alarms import ALARMS
from sawmill_platform.backups import restoring, taking
from sawmill_platform.backups.row_contracts import OF_THE_SERVICE, Readers, loaded, read_any_event
from sawmill_platform.contracts.events import Event
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.contracts.kind_declarations import declaration_of
from sawmill_platform.database.tables import EventRow
from sawmill_platform.due_times import next_due
from sawmill_store.alarms import read_alarm
from sawmill_store.drift_charts import read_chart
from sawmill_store.history import read_entry
from sawmill_store.measurements import read_measurement
from sawmill_store.mill_tables import (
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
from sawmill_store.named_folders import NAMED_FOLDERS
from sawmill_store.phantoms import picture_of, read_phantom
from sawmill_store.requests.asked_rows import read_asked
from sawmill_store.retention.retention_store import read_retention
from sawmill_store.scanners import read_scanner
from sawmill_store.scans import read_scan
from sawmill_store.schedules import read_schedule, read_schedule_run

_OBJECT = TypeAdapter(dict[str, object])


def _read_event(session: Session, row: EventRow) -> Event:
    if row.topic is not None:
        read_entry(row, None, stored=False)
    return read_any_event(session, row)


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


READERS: Readers = {
    **OF_THE_SERVICE,
    EventRow: _read_event,
    ScannerRow: read_scanner,
    PhantomRow: _read_phantom,
    ScanRow: _read_scan,
    **dict.fromkeys((AskedRow, CalibrationRow, ReconstructionRow, DriftRow, PlanRow), _read_asked),
    ActivationRow: loaded,
    MeasurementRow: lambda _, row: read_measurement(row),
    DriftChartRow: _read_chart,
    ScheduleRow: _read_schedule,
    ScheduleRunRow: lambda _, row: read_schedule_run(row),
    AlarmRow: _read_alarm,
    RetentionRow: lambda _, row: read_retention(row, row.changed_at),
}

take_backup = partial(taking.take_backup, named=NAMED_FOLDERS)
"""Take a backup of a mill's store (`sawmill_platform/backups/taking.py`)."""
restore = partial(restoring.restore, readers=READERS)
"""Restore a backup of a mill's store (`sawmill_platform/backups/restoring.py`)."""
