"""The rows. Specifications and results are JSON: the contracts own their shape, the columns are what is searched by."""

from collections.abc import Mapping
from datetime import UTC, date, datetime
from enum import StrEnum
from typing import Annotated, Any, ClassVar

from sqlalchemy import (
    JSON,
    BigInteger,
    ColumnElement,
    DateTime,
    Dialect,
    Enum,
    Float,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    String,
    TypeDecorator,
    UniqueConstraint,
    func,
    text,
)
from sqlalchemy.orm import DeclarativeBase, Mapped, declared_attr, mapped_column, relationship

from sawmill_contracts.alarms import AlarmKind
from sawmill_contracts.history import HistoryKind
from sawmill_contracts.measurements import MeasurementKind
from sawmill_contracts.phantoms import PhantomState
from sawmill_contracts.scans import ScanState
from sawmill_platform.contracts.audit import AuditAction
from sawmill_platform.contracts.events import EventKind
from sawmill_platform.contracts.jobs import JobKind, JobState, Priority
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.contracts.uploads import UploadState
from sawmill_platform.contracts.webhooks import DeliveryState

Json = dict[str, Any]


class UtcDateTime(TypeDecorator[datetime]):
    """Aware datetimes in, aware UTC datetimes out, on databases with and without time zones."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:  # noqa: ARG002
        """Convert to UTC; a naive time is refused."""
        if value is None:
            return None
        if value.tzinfo is None:
            msg = f"a stored time must carry its time zone: {value!r}"
            raise ValueError(msg)
        return value.astimezone(UTC)

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:  # noqa: ARG002
        """Mark it as UTC."""
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


def seconds_between(dialect: str, start: Any, end: Any) -> ColumnElement[Any]:  # noqa: ANN401 - columns or times
    """From one column to another, as a database works it out."""
    if dialect == "sqlite":
        return (func.julianday(end) - func.julianday(start)) * 86_400.0
    return func.extract("epoch", end - start)


class Ranked(TypeDecorator[Priority]):
    """A priority, stored as its rank so that the queue's order is the column's."""

    impl = Integer
    cache_ok = True

    def process_bind_param(self, value: Priority | None, dialect: Dialect) -> int | None:  # noqa: ARG002
        """The rank."""
        return None if value is None else value.rank

    def process_result_value(self, value: int | None, dialect: Dialect) -> Priority | None:  # noqa: ARG002
        """The priority of a rank."""
        return next((priority for priority in Priority if priority.rank == value), None)


def _words(kind: type[StrEnum], length: int = 20) -> Enum:
    """Stored as its value in a plain text column, so that a new word needs no migration."""
    return Enum(kind, native_enum=False, length=length, values_callable=lambda words: [word.value for word in words])


# Of the upload and the results: null until it was measured, once its job has ended (`sawmill_store/measured_bytes.py`).
StoredBytes = Annotated[int | None, mapped_column(BigInteger)]


def _by_age(name: str, which: str | None = None) -> Index:
    """Finds the oldest, and sums up bytes without a look at the rows."""
    where = None if which is None else text(which)
    return Index(name, "created_at", "id", "stored_bytes", sqlite_where=where, postgresql_where=where)


def _not_measured(table: str) -> Index:
    where = text("stored_bytes IS NULL")
    return Index(f"ix_{table}_not_measured", "id", sqlite_where=where, postgresql_where=where)


class Base(DeclarativeBase):
    """Typed declarative base with named constraints, which migrations need."""

    metadata = MetaData(
        naming_convention={
            "ix": "ix_%(table_name)s_%(column_0_N_name)s",
            "uq": "uq_%(table_name)s_%(column_0_N_name)s",
            "fk": "fk_%(table_name)s_%(column_0_name)s",
            "pk": "pk_%(table_name)s",
        }
    )
    type_annotation_map: ClassVar[Mapping[Any, Any]] = {
        Json: JSON(none_as_null=True),
        datetime: UtcDateTime(),
        AlarmKind: _words(AlarmKind, 40),
        AuditAction: _words(AuditAction, 40),
        DeliveryState: _words(DeliveryState),
        EventKind: _words(EventKind, 40),
        HistoryKind: _words(HistoryKind),
        JobKind: _words(JobKind),
        JobState: _words(JobState),
        MeasurementKind: _words(MeasurementKind),
        Priority: Ranked(),
        PhantomState: _words(PhantomState),
        ScanState: _words(ScanState),
        Scope: _words(Scope),
        UploadState: _words(UploadState),
    }


class Resource(Base):
    """What every resource has."""

    __abstract__ = True

    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    created_at: Mapped[datetime]


class JobRow(Resource):
    """The row is the job (docs/architecture.md#jobs)."""

    __tablename__ = "jobs"
    # Lists, all or in one state; claims and places in the queue; counts.
    __table_args__ = (
        Index(None, "created_at", "id"),
        Index(None, "state", "created_at", "id"),
        Index("ix_jobs_queue", "state", "priority", "group_id", "created_at", "id", "short", "kind"),
        Index("ix_jobs_places", "state", "priority", "short", "kind", "created_at", "id"),
        # Of one key (`sawmill_platform/jobs/queue_limits.py`).
        Index(
            "ix_jobs_queued_of_key",
            "key_id",
            sqlite_where=text("state = 'queued'"),
            postgresql_where=text("state = 'queued'"),
        ),
    )

    kind: Mapped[JobKind]
    state: Mapped[JobState]
    subject_id: Mapped[str] = mapped_column(String(64), index=True)
    priority: Mapped[Priority] = mapped_column(default=Priority.WAITED_FOR)
    # Whether it takes seconds: such jobs have a lane in which none waits for a long one.
    short: Mapped[bool] = mapped_column(default=False)
    # Groups take turns (`sawmill_platform/jobs/turns.py`); the jobs of none, which is empty, are one as well.
    group_id: Mapped[str] = mapped_column(String(64), default="")
    # Fences: grows with each claim. Attempts that were lost are counted apart, and so are full disks in a row.
    attempt: Mapped[int] = mapped_column(default=0)
    losses: Mapped[int] = mapped_column(default=0)
    outages: Mapped[int] = mapped_column(default=0)
    worker: Mapped[str | None] = mapped_column(String(200))
    # Heartbeats of the attempt: an observer that sees no new one for the time of a lease takes the job back.
    beats: Mapped[int] = mapped_column(default=0)
    # Seconds since 1970 by the store's clock.
    not_before_s: Mapped[float | None] = mapped_column(Float(53))
    waiting_for: Mapped[Json | None]
    cancel_requested: Mapped[bool] = mapped_column(default=False)
    progress: Mapped[Json | None]
    failure: Mapped[Json | None]
    # Whose request queued it; null where none did.
    request_id: Mapped[str | None] = mapped_column(String(64))
    key_id: Mapped[str | None] = mapped_column(String(64))
    asked_by: Mapped[str | None] = mapped_column(String(200))
    started_at: Mapped[datetime | None]
    finished_at: Mapped[datetime | None]


class JobTurnRow(Base):
    """When a group was served last, by workers of one lane and at one priority: a number (`sawmill_platform/jobs/turns.py`)."""

    __tablename__ = "job_turns"

    short_only: Mapped[bool] = mapped_column(primary_key=True)
    priority: Mapped[Priority] = mapped_column(primary_key=True, autoincrement=False)
    group_id: Mapped[str] = mapped_column(String(64), primary_key=True)
    turn: Mapped[int] = mapped_column(BigInteger)


class JobDependencyRow(Base):
    """A job may start only when all the jobs it needs have ended."""

    __tablename__ = "job_dependencies"

    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id"), primary_key=True)
    needs_job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id"), primary_key=True, index=True)


class EventRow(Base):
    """What happened; written with the change itself. Rows of jobs of the first versions name no subject."""

    __tablename__ = "events"
    __table_args__ = (Index(None, "scanner_id", "number"), Index(None, "what", "number"))

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    at: Mapped[datetime]
    what: Mapped[EventKind]
    scanner_id: Mapped[str | None] = mapped_column(String(64))
    subject: Mapped[str | None] = mapped_column(String(20))
    subject_id: Mapped[str | None] = mapped_column(String(64))
    job_id: Mapped[str | None] = mapped_column(String(64), index=True)
    attempt: Mapped[int | None]
    worker: Mapped[str | None] = mapped_column(String(200))
    detail: Mapped[Json | None]


class ClockRow(Base):
    """One row, on SQLite alone: seconds since 1970 at the boot of this machine (`storage.clock`)."""

    __tablename__ = "clock"

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    boot: Mapped[str] = mapped_column(String(64))
    offset_s: Mapped[float] = mapped_column(Float(53))


class DataFolderRow(Base):
    """One row: the identity of the data folder that has this database's files (`sawmill_platform/files/folder_identity.py`)."""

    __tablename__ = "data_folder"

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    identity: Mapped[str] = mapped_column(String(64))


class ScannerRow(Resource):
    """A scanner; its active calibration is its newest activation."""

    __tablename__ = "scanners"

    spec: Mapped[Json]


class PhantomRow(Resource):
    """A phantom."""

    __tablename__ = "phantoms"

    name: Mapped[str] = mapped_column(String(200))
    built_in: Mapped[bool]
    state: Mapped[PhantomState]
    reason: Mapped[str | None]
    drawing: Mapped[Json | None]
    picture: Mapped[Json | None]
    job_id: Mapped[str | None] = mapped_column(ForeignKey("jobs.id"), index=True)


class ScanRow(Resource):
    """A scan; `spec` holds what its uploader gave, apart from the two columns."""

    __tablename__ = "scans"
    # The newest of a scanner, and the newest phantom scan among thousands of logs; the oldest of both sorts.
    __table_args__ = (
        Index(None, "scanner_id", "created_at"),
        _by_age("ix_scans_logs_by_age", "phantom_id IS NULL"),
        _by_age("ix_scans_phantoms_by_age", "phantom_id IS NOT NULL"),
        _not_measured("scans"),
        # Of phantoms alone: SQLite would find all logs by it, and then sort them.
        Index(
            None,
            "phantom_id",
            sqlite_where=text("phantom_id IS NOT NULL"),
            postgresql_where=text("phantom_id IS NOT NULL"),
        ),
        Index(
            "ix_scans_of_phantoms",
            "scanner_id",
            "created_at",
            sqlite_where=text("phantom_id IS NOT NULL"),
            postgresql_where=text("phantom_id IS NOT NULL"),
        ),
    )

    scanner_id: Mapped[str] = mapped_column(ForeignKey("scanners.id"))
    phantom_id: Mapped[str | None] = mapped_column(ForeignKey("phantoms.id"))
    spec: Mapped[Json]
    state: Mapped[ScanState]
    reason: Mapped[str | None]
    size_bytes: Mapped[int] = mapped_column(BigInteger)
    sha256: Mapped[str] = mapped_column(String(64))
    reading: Mapped[Json | None]
    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id"), index=True)
    stored_bytes: Mapped[StoredBytes]


class UploadRow(Resource):
    """An upload that can be resumed; `offset_bytes` of it are on the disk."""

    __tablename__ = "uploads"

    name: Mapped[str | None] = mapped_column(String(200))
    key_id: Mapped[str | None] = mapped_column(String(64))
    size_bytes: Mapped[int] = mapped_column(BigInteger)
    offset_bytes: Mapped[int] = mapped_column(BigInteger)
    sha256: Mapped[str | None] = mapped_column(String(64))
    state: Mapped[UploadState]
    used_by: Mapped[str | None] = mapped_column(String(200))
    changed_at: Mapped[datetime] = mapped_column(index=True)


class Answered(Resource):
    """What somebody asked for and a job answers; its state is its job's. It outlives its scan, whose id it keeps."""

    __abstract__ = True

    options: Mapped[Json]
    result: Mapped[Json | None]
    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id"), unique=True)

    @declared_attr
    def job(cls) -> Mapped[JobRow]:  # noqa: N805 - called with the class
        """The job that answers it."""
        return relationship(JobRow, lazy="joined", innerjoin=True)

    @classmethod
    def own_columns(cls) -> frozenset[str]:
        """What a table has beside the columns of every one: references' ids, most of them."""
        shared = {"id", "created_at", "options", "result", "job_id"}
        return frozenset(column.key for column in cls.__table__.columns) - shared


class AskedRow(Answered):
    """What was asked of any kind that has no table of its own; the kind decides what may be deleted before it."""

    __tablename__ = "asked"
    __table_args__ = (Index(None, "created_at", "id"),)

    scanner_id: Mapped[str | None] = mapped_column(String(64), index=True)
    scan_id: Mapped[str | None] = mapped_column(String(64), index=True)
    phantom_id: Mapped[str | None] = mapped_column(String(64), index=True)
    calibration_id: Mapped[str | None] = mapped_column(ForeignKey("calibrations.id"), index=True)


class CalibrationRow(Answered):
    """A calibration. It outlives its schedule, whose id it keeps."""

    __tablename__ = "calibrations"
    __table_args__ = (
        Index(None, "scanner_id", "created_at"),
        _by_age("ix_calibrations_by_age"),
        _not_measured("calibrations"),
    )

    scanner_id: Mapped[str] = mapped_column(ForeignKey("scanners.id"))
    scan_id: Mapped[str] = mapped_column(String(64), index=True)
    phantom_id: Mapped[str] = mapped_column(ForeignKey("phantoms.id"), index=True)
    schedule_id: Mapped[str | None] = mapped_column(String(64))
    activate: Mapped[bool]
    stored_bytes: Mapped[StoredBytes]


class ReconstructionRow(Answered):
    """A reconstruction."""

    __tablename__ = "reconstructions"
    __table_args__ = (
        Index(None, "scanner_id", "created_at"),
        _by_age("ix_reconstructions_by_age"),
        _not_measured("reconstructions"),
    )

    scanner_id: Mapped[str] = mapped_column(ForeignKey("scanners.id"))
    scan_id: Mapped[str] = mapped_column(String(64), index=True)
    calibration_id: Mapped[str | None] = mapped_column(ForeignKey("calibrations.id"), index=True)
    stored_bytes: Mapped[StoredBytes]


class DriftRow(Answered):
    """A drift check."""

    __tablename__ = "drifts"
    __table_args__ = (Index(None, "scanner_id", "created_at"), Index(None, "created_at", "id"))

    scanner_id: Mapped[str] = mapped_column(ForeignKey("scanners.id"))
    scan_id: Mapped[str] = mapped_column(String(64), index=True)
    calibration_id: Mapped[str] = mapped_column(ForeignKey("calibrations.id"), index=True)


class PlanRow(Answered):
    """A plan. It outlives its phantom and its scanner, whose ids it keeps."""

    __tablename__ = "plans"

    phantom_id: Mapped[str] = mapped_column(String(64))
    scanner_id: Mapped[str] = mapped_column(String(64))


# Of the first versions. A new kind needs none: its rows stand in `asked`.
OWN_TABLES: dict[JobKind, type[Answered]] = {
    JobKind.CALIBRATE: CalibrationRow,
    JobKind.RECONSTRUCT: ReconstructionRow,
    JobKind.DRIFT: DriftRow,
    JobKind.PLAN: PlanRow,
}


def table_of(kind: JobKind) -> type[Answered]:
    """Where what was asked of a kind is stored."""
    return OWN_TABLES.get(kind, AskedRow)


class ActivationRow(Base):
    """From then on this calibration was its scanner's active one."""

    __tablename__ = "activations"

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    scanner_id: Mapped[str] = mapped_column(ForeignKey("scanners.id"), index=True)
    calibration_id: Mapped[str] = mapped_column(ForeignKey("calibrations.id"), index=True)
    activated_at: Mapped[datetime]
    reason: Mapped[str]


class MeasurementRow(Base):
    """What a calibration or a drift check measured of its scanner."""

    __tablename__ = "measurements"
    # Those of a scanner, and the last weeks of all of them; looks since an activation, one of a file, those that wait.
    __table_args__ = (
        Index(None, "scanner_id", "number"),
        Index(None, "scanner_id", "at"),
        Index(
            "ix_measurements_looks",
            "activation_number",
            "method",
            "number",
            sqlite_where=text("activation_number IS NOT NULL"),
            postgresql_where=text("activation_number IS NOT NULL"),
        ),
        Index(
            "ix_measurements_counted",
            "activation_number",
            "method",
            "input_sha256",
            sqlite_where=text("activation_number IS NOT NULL"),
            postgresql_where=text("activation_number IS NOT NULL"),
        ),
        Index(
            "ix_measurements_awaiting_chart",
            "scanner_id",
            "number",
            sqlite_where=text("awaits_chart IS NOT NULL"),
            postgresql_where=text("awaits_chart IS NOT NULL"),
        ),
    )

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    scanner_id: Mapped[str] = mapped_column(ForeignKey("scanners.id"))
    at: Mapped[datetime] = mapped_column(index=True)
    kind: Mapped[MeasurementKind]
    subject_id: Mapped[str] = mapped_column(String(64))
    against_id: Mapped[str | None] = mapped_column(String(64))
    ray_change_mm: Mapped[float | None] = mapped_column(Float(53))
    ray_change_tolerance_mm: Mapped[float | None] = mapped_column(Float(53))
    within_tolerance: Mapped[bool | None]
    scale_change_percent: Mapped[float | None] = mapped_column(Float(53))
    cor_column_mm: Mapped[float] = mapped_column(Float(53))
    cor_column_standard_deviation_mm: Mapped[float | None] = mapped_column(Float(53))
    cor_column_change_mm: Mapped[float | None] = mapped_column(Float(53))
    tilt_deg: Mapped[float] = mapped_column(Float(53))
    tilt_standard_deviation_deg: Mapped[float | None] = mapped_column(Float(53))
    tilt_change_deg: Mapped[float | None] = mapped_column(Float(53))
    source_to_detector_mm: Mapped[float] = mapped_column(Float(53))
    source_to_detector_standard_deviation_mm: Mapped[float | None] = mapped_column(Float(53))
    source_distance_mm: Mapped[float | None] = mapped_column(Float(53))
    relative_residual: Mapped[float] = mapped_column(Float(53))
    gain: Mapped[float | None] = mapped_column(Float(53))
    ray_error_rms_mm: Mapped[float | None] = mapped_column(Float(53))
    ray_error_upper_95_mm: Mapped[float | None] = mapped_column(Float(53))
    scale_uncertainty_percent: Mapped[float | None] = mapped_column(Float(53))
    verdict: Mapped[str | None] = mapped_column(String(20))
    rays_verdict: Mapped[str | None] = mapped_column(String(20))
    # Of a drift check alone, from here on. Its error, beside the two standard deviations.
    cor_column_tilt_covariance_mm_deg: Mapped[float | None] = mapped_column(Float(53))
    method: Mapped[str | None] = mapped_column(String(20))
    # Against the baseline, where it had one.
    baseline_looks: Mapped[int | None]
    baseline_age_hours: Mapped[float | None] = mapped_column(Float(53))
    cor_column_baseline_change_mm: Mapped[float | None] = mapped_column(Float(53))
    tilt_baseline_change_deg: Mapped[float | None] = mapped_column(Float(53))
    # The activation that it is a look since; null: it does not count for the scanner's chart.
    activation_number: Mapped[int | None]
    input_sha256: Mapped[str | None] = mapped_column(String(64))
    # True until the chart has it, then null.
    awaits_chart: Mapped[bool | None]
    # With the looks before it, once the chart has it (`sawmill_store/drift_charts.py`).
    pooled_looks: Mapped[int | None]
    pooled_cor_column_mm: Mapped[float | None] = mapped_column(Float(53))
    pooled_cor_column_standard_deviation_mm: Mapped[float | None] = mapped_column(Float(53))
    pooled_tilt_deg: Mapped[float | None] = mapped_column(Float(53))
    pooled_tilt_standard_deviation_deg: Mapped[float | None] = mapped_column(Float(53))


class DriftChartRow(Base):
    """The chart of a scanner's drift checks by one method since its newest activation."""

    __tablename__ = "drift_charts"

    scanner_id: Mapped[str] = mapped_column(ForeignKey("scanners.id", ondelete="CASCADE"), primary_key=True)
    method: Mapped[str] = mapped_column(String(20), primary_key=True)
    activation_number: Mapped[int]
    # What the chart goes on from (`tomography/drift_chart`), the looks in it and when the newest of them ended.
    state: Mapped[Json]
    looks: Mapped[int]
    changed_at: Mapped[datetime]
    baseline: Mapped[Json | None]
    finding: Mapped[Json]
    # The finding that opened the alarm, kept until another calibration is active.
    alarm: Mapped[Json | None]


class HistoryRow(Base):
    """What happened to a scanner, by whom and why; it outlasts what it is about, and the events."""

    __tablename__ = "history"
    # A page of all or of one kind, from any time on.
    __table_args__ = (
        Index("ix_history_scanner_id_at", "scanner_id", "at", "number"),
        Index("ix_history_scanner_id_kind_at", "scanner_id", "kind", "at", "number"),
    )

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    scanner_id: Mapped[str] = mapped_column(String(64))
    at: Mapped[datetime]
    kind: Mapped[HistoryKind]
    what: Mapped[EventKind]
    subject: Mapped[str] = mapped_column(String(20))
    subject_id: Mapped[str] = mapped_column(String(64))
    who: Mapped[str | None] = mapped_column(String(200))
    key_id: Mapped[str | None] = mapped_column(String(64))
    why: Mapped[str | None]
    alarm: Mapped[AlarmKind | None]
    measurement_number: Mapped[int | None] = mapped_column(ForeignKey("measurements.number"))


class ScheduleRow(Resource):
    """When to recalibrate or to look for drift; `next_due_at` is null when disabled."""

    __tablename__ = "schedules"

    scanner_id: Mapped[str] = mapped_column(ForeignKey("scanners.id"))
    kind: Mapped[str] = mapped_column(String(20))
    cron: Mapped[str] = mapped_column(String(100))
    time_zone: Mapped[str] = mapped_column(String(64))
    enabled: Mapped[bool]
    on_pass: Mapped[str] = mapped_column(String(20))
    options: Mapped[Json]
    drift_options: Mapped[Json]
    next_due_at: Mapped[datetime | None] = mapped_column(index=True)
    # Whether the last due time was missed, and announced so: the next ones are not announced again.
    missed: Mapped[bool] = mapped_column(default=False)


class ScheduleRunRow(Base):
    """The outcome of one due time; the constraint makes it once only."""

    __tablename__ = "schedule_runs"
    __table_args__ = (UniqueConstraint("schedule_id", "due_at"),)

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    schedule_id: Mapped[str] = mapped_column(ForeignKey("schedules.id", ondelete="CASCADE"))
    due_at: Mapped[datetime]
    outcome: Mapped[str] = mapped_column(String(40))
    calibration_id: Mapped[str | None] = mapped_column(ForeignKey("calibrations.id"), index=True)
    drift_id: Mapped[str | None] = mapped_column(String(64))


class AlarmRow(Base):
    """An alarm that is open; the key makes it one of its sort."""

    __tablename__ = "alarms"

    scanner_id: Mapped[str] = mapped_column(ForeignKey("scanners.id", ondelete="CASCADE"), primary_key=True)
    what: Mapped[AlarmKind] = mapped_column(primary_key=True)
    since: Mapped[datetime]
    last_at: Mapped[datetime | None]
    limit_hours: Mapped[float | None] = mapped_column(Float(53))
    phantom_id: Mapped[str | None] = mapped_column(String(64))
    expired_on: Mapped[date | None]
    drift: Mapped[Json | None]


class RetentionRow(Base):
    """One row, once there are rules: how long what is kept, and by kind how many went so far and what that freed."""

    __tablename__ = "retention"

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    rules: Mapped[Json]
    # Grows with each change.
    revision: Mapped[int]
    changed_at: Mapped[datetime]
    changed_by: Mapped[str] = mapped_column(String(200))
    # When days were counted last; null: not since the change.
    followed_at: Mapped[datetime | None]
    removed: Mapped[Json]


class KeyRow(Resource):
    """A key. Its secret is known by its hash alone, and so is the one before, which a rotation may let live on."""

    __tablename__ = "keys"

    name: Mapped[str] = mapped_column(String(200))
    scope: Mapped[Scope]
    display: Mapped[bool]
    secret_hash: Mapped[str] = mapped_column(String(64), index=True, unique=True)
    previous_hash: Mapped[str | None] = mapped_column(String(64), index=True)
    previous_until: Mapped[datetime | None]
    rotated_at: Mapped[datetime | None]
    expires_at: Mapped[datetime | None]
    revoked_at: Mapped[datetime | None]
    last_used_at: Mapped[datetime | None]
    created_by: Mapped[str] = mapped_column(String(200))


class SessionRow(Base):
    """A browser that brought a key, or the token; it ends with what opened it, whose hash it keeps."""

    __tablename__ = "sessions"

    secret_hash: Mapped[str] = mapped_column(String(64), primary_key=True)
    opened_by_hash: Mapped[str] = mapped_column(String(64))
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime | None]


class WebhookRow(Resource):
    """Who is sent which events; `after` is the number of the last one with which it is done."""

    __tablename__ = "webhooks"

    url: Mapped[str] = mapped_column(String(2000))
    description: Mapped[str | None] = mapped_column(String(200))
    events: Mapped[list[str]] = mapped_column(JSON)
    enabled: Mapped[bool]
    paused: Mapped[bool] = mapped_column(default=False)
    # In the clear: signing needs it.
    secret: Mapped[str] = mapped_column(String(100))
    previous_secret: Mapped[str | None] = mapped_column(String(100))
    previous_secret_until: Mapped[datetime | None]
    after: Mapped[int]
    delivered: Mapped[int] = mapped_column(default=0)
    failed: Mapped[int] = mapped_column(default=0)
    failures: Mapped[int] = mapped_column(default=0)
    next_attempt_at: Mapped[datetime | None]
    last_success_at: Mapped[datetime | None]
    last_failure_at: Mapped[datetime | None]
    last_failure: Mapped[str | None]


class DeliveryRow(Base):
    """An event that was sent to a webhook; written after the attempt, and forgotten some days later."""

    __tablename__ = "webhook_deliveries"
    __table_args__ = (UniqueConstraint("webhook_id", "event_number"), Index(None, "last_at"))

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    webhook_id: Mapped[str] = mapped_column(ForeignKey("webhooks.id", ondelete="CASCADE"))
    event_number: Mapped[int]
    message_id: Mapped[str] = mapped_column(String(64))
    what: Mapped[EventKind]
    state: Mapped[DeliveryState]
    attempts: Mapped[int]
    first_at: Mapped[datetime]
    last_at: Mapped[datetime]
    status: Mapped[int | None]
    reason: Mapped[str | None]


class SenderRow(Base):
    """One row: the process that sends to webhooks, and until when no other one does."""

    __tablename__ = "webhook_sender"

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    holder: Mapped[str] = mapped_column(String(64))
    held_until: Mapped[datetime]


class RepeatRow(Base):
    """The answer to a request with an `Idempotency-Key`, for its repeats; `answer` is null until it is made."""

    __tablename__ = "repeats"

    caller: Mapped[str] = mapped_column(String(200), primary_key=True)
    key: Mapped[str] = mapped_column(String(200), primary_key=True)
    created_at: Mapped[datetime] = mapped_column(index=True)
    # SHA-256 of method, path, query and JSON; of a file that was sent.
    request_sha256: Mapped[str] = mapped_column(String(64))
    file_sha256: Mapped[str | None] = mapped_column(String(64))
    answer: Mapped[Json | None]


class AuditRow(Base):
    """Who did what; the database refuses to change or remove a row."""

    __tablename__ = "audit"
    __table_args__ = (Index(None, "subject_id", "at"),)

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    at: Mapped[datetime]
    who: Mapped[str] = mapped_column(String(200))
    key_id: Mapped[str | None] = mapped_column(String(64))
    address: Mapped[str | None] = mapped_column(String(64))
    request_id: Mapped[str | None] = mapped_column(String(64))
    action: Mapped[AuditAction]
    subject_id: Mapped[str] = mapped_column(String(64))
    detail: Mapped[Json | None]
