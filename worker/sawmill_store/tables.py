"""The rows of a mill. Specifications and results are JSON: the contracts own their shape."""

from datetime import date, datetime
from pathlib import Path
from typing import Annotated

from sqlalchemy import (
    BigInteger,
    Float,
    ForeignKey,
    Index,
    String,
    UniqueConstraint,
    text,
)
from sqlalchemy.orm import Mapped, declared_attr, mapped_column, relationship

from sawmill_contracts import job_kinds
from sawmill_contracts.alarms import AlarmKind
from sawmill_contracts.measurements import MeasurementKind
from sawmill_contracts.phantoms import PhantomState
from sawmill_contracts.scans import ScanState
from sawmill_platform.contracts.jobs import JobKind
from sawmill_platform.database.tables import Base, JobRow, Json, Resource, words

Base.metadata.info["migrations"] = Path(__file__).with_name("migrations")
Base.registry.update_type_annotation_map(
    {
        AlarmKind: words(AlarmKind, 40),
        MeasurementKind: words(MeasurementKind),
        PhantomState: words(PhantomState),
        ScanState: words(ScanState),
    }
)

# Of the upload and the results: null until it was measured, after its job has ended (`retention/measured_bytes.py`).
StoredBytes = Annotated[int | None, mapped_column(BigInteger)]


def _by_age(name: str, which: str | None = None) -> Index:
    """Finds the oldest, and sums up bytes without a look at the rows."""
    where = None if which is None else text(which)
    return Index(name, "created_at", "id", "stored_bytes", sqlite_where=where, postgresql_where=where)


def _not_measured(table: str) -> Index:
    where = text("stored_bytes IS NULL")
    return Index(f"ix_{table}_not_measured", "id", sqlite_where=where, postgresql_where=where)


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
    job_kinds.CALIBRATE: CalibrationRow,
    job_kinds.RECONSTRUCT: ReconstructionRow,
    job_kinds.DRIFT: DriftRow,
    job_kinds.PLAN: PlanRow,
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
    subject_id: Mapped[str] = mapped_column(String(64), index=True)
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
