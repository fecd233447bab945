"""The rows of a mill. Specifications and results are JSON: the contracts own their shape."""

import math
from collections.abc import Sequence
from datetime import date, datetime
from pathlib import Path
from typing import Any

from sqlalchemy import JSON, BigInteger, Float, ForeignKey, Index, String, UniqueConstraint, func, select
from sqlalchemy.engine.default import DefaultExecutionContext
from sqlalchemy.ext.hybrid import hybrid_property
from sqlalchemy.orm import Mapped, declared_attr, mapped_column, relationship

from sawmill_contracts import kinds
from sawmill_contracts.alarms import AlarmKind
from sawmill_contracts.measurements import MeasurementKind
from sawmill_contracts.phantoms import PhantomState
from sawmill_contracts.scans import ScanState
from sawmill_platform.contracts.jobs import JobKind
from sawmill_platform.database.tables import Base, JobRow, Json, Resource, partial_index, words

Base.metadata.info["migrations"] = Path(__file__).with_name("migrations")
Base.registry.update_type_annotation_map(
    {
        AlarmKind: words(AlarmKind, 40),
        MeasurementKind: words(MeasurementKind),
        PhantomState: words(PhantomState),
        ScanState: words(ScanState),
    }
)


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
    # Indexes: newest scan of a scanner, newest phantom scan among thousands of logs, oldest scans of both sorts.
    __table_args__ = (
        Index(None, "scanner_id", "created_at"),
        partial_index("ix_scans_logs_by_age", "phantom_id IS NULL", "created_at", "id"),
        partial_index("ix_scans_phantoms_by_age", "phantom_id IS NOT NULL", "created_at", "id"),
        # The index has phantom scans only: with logs in it, SQLite would read all logs, and then sort them.
        partial_index(None, "phantom_id IS NOT NULL", "phantom_id"),
        partial_index("ix_scans_of_phantoms", "phantom_id IS NOT NULL", "scanner_id", "created_at"),
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


class Answered(Resource):
    """A request that a job answers, in the state of the job. The row outlives its scan, whose id it keeps."""

    __abstract__ = True

    options: Mapped[Json]
    result: Mapped[Json | None]
    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id"), unique=True)

    @declared_attr
    def job(cls) -> Mapped[JobRow]:  # noqa: N805 - called with the class
        """Return the relationship to the job that answers the request."""
        return relationship(JobRow, lazy="joined", innerjoin=True)

    @classmethod
    def own_columns(cls) -> frozenset[str]:
        """Return the columns that only this table has: most are ids of references."""
        shared = {"id", "created_at", "options", "result", "job_id"}
        return frozenset(column.key for column in cls.__table__.columns) - shared


class AskedRow(Answered):
    """A request of any kind without its own table; the kind decides which references may be deleted before it."""

    __tablename__ = "asked"
    __table_args__ = (Index(None, "created_at", "id"),)

    scanner_id: Mapped[str | None] = mapped_column(String(64), index=True)
    scan_id: Mapped[str | None] = mapped_column(String(64), index=True)
    phantom_id: Mapped[str | None] = mapped_column(String(64), index=True)
    calibration_id: Mapped[str | None] = mapped_column(ForeignKey("calibrations.id"), index=True)


class CalibrationRow(Answered):
    """A calibration. It outlives its schedule, whose id it keeps."""

    __tablename__ = "calibrations"
    __table_args__ = (Index(None, "scanner_id", "created_at"), Index("ix_calibrations_by_age", "created_at", "id"))

    scanner_id: Mapped[str] = mapped_column(ForeignKey("scanners.id"))
    scan_id: Mapped[str] = mapped_column(String(64), index=True)
    phantom_id: Mapped[str] = mapped_column(ForeignKey("phantoms.id"), index=True)
    schedule_id: Mapped[str | None] = mapped_column(String(64))
    activate: Mapped[bool]


def _log_number(context: DefaultExecutionContext) -> int:
    """Return the number of the log that a new reconstruction shows: one that its scan has, or the scanner's next."""
    row, rows = context.get_current_parameters(), ReconstructionRow  # type: ignore[no-untyped-call]
    of_scan = select(rows.number).where(rows.scan_id == row["scan_id"]).limit(1)
    following = select(func.coalesce(func.max(rows.number), 0) + 1).where(rows.scanner_id == row["scanner_id"])
    connection = context.root_connection
    return connection.scalar(of_scan) or connection.scalars(following).one()


class ReconstructionRow(Answered):
    """A reconstruction."""

    __tablename__ = "reconstructions"
    __table_args__ = (Index(None, "scanner_id", "created_at"), Index("ix_reconstructions_by_age", "created_at", "id"))

    scanner_id: Mapped[str] = mapped_column(ForeignKey("scanners.id"))
    scan_id: Mapped[str] = mapped_column(String(64), index=True)
    calibration_id: Mapped[str | None] = mapped_column(ForeignKey("calibrations.id"), index=True)
    number: Mapped[int] = mapped_column(default=_log_number)
    name: Mapped[str | None] = mapped_column(String(200))
    marks: Mapped[list[Json]] = mapped_column(JSON, default=list)


class DriftRow(Answered):
    """A drift check."""

    __tablename__ = "drifts"
    __table_args__ = (Index(None, "scanner_id", "created_at"), Index(None, "created_at", "id"))

    scanner_id: Mapped[str] = mapped_column(ForeignKey("scanners.id"))
    scan_id: Mapped[str] = mapped_column(String(64), index=True)
    calibration_id: Mapped[str | None] = mapped_column(ForeignKey("calibrations.id"), index=True)


class PlanRow(Answered):
    """A plan. It outlives its phantom and its scanner, whose ids it keeps."""

    __tablename__ = "plans"

    phantom_id: Mapped[str] = mapped_column(String(64))
    scanner_id: Mapped[str] = mapped_column(String(64))


# Tables of the kinds of the first versions. A new kind needs no table: its rows are in `asked`.
OWN_TABLES: dict[JobKind, type[Answered]] = {
    kinds.CALIBRATE: CalibrationRow,
    kinds.RECONSTRUCT: ReconstructionRow,
    kinds.DRIFT: DriftRow,
    kinds.PLAN: PlanRow,
}


def table_of(kind: JobKind) -> type[Answered]:
    """Return the table of the requests of a kind."""
    return OWN_TABLES.get(kind, AskedRow)


class ActivationRow(Base):
    """An activation: from this time on the calibration was its scanner's active one."""

    __tablename__ = "activations"

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    scanner_id: Mapped[str] = mapped_column(ForeignKey("scanners.id"), index=True)
    calibration_id: Mapped[str] = mapped_column(ForeignKey("calibrations.id"), index=True)
    activated_at: Mapped[datetime]
    reason: Mapped[str]


def _in_degrees(name: str) -> hybrid_property[Any]:
    """Convert a column in radians to degrees, in rows and in statements."""
    return hybrid_property(lambda row: None if getattr(row, name) is None else getattr(row, name) * math.degrees(1.0))


_IN_CHART = "activation_number IS NOT NULL"


class MeasurementRow(Base):
    """A measurement of a scanner by a calibration or a drift check."""

    __tablename__ = "measurements"
    # Indexes: measurements of a scanner, last weeks of all scanners, drift checks since an activation, the check of a
    # file, checks that wait.
    __table_args__ = (
        Index(None, "scanner_id", "number"),
        Index(None, "scanner_id", "at"),
        partial_index("ix_measurements_looks", _IN_CHART, "activation_number", "method", "number"),
        partial_index("ix_measurements_counted", _IN_CHART, "activation_number", "method", "input_sha256"),
        partial_index("ix_measurements_awaiting_chart", "awaits_chart IS NOT NULL", "scanner_id", "number"),
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
    tilt_rad: Mapped[float] = mapped_column(Float(53))
    tilt_standard_deviation_rad: Mapped[float | None] = mapped_column(Float(53))
    tilt_change_rad: Mapped[float | None] = mapped_column(Float(53))
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
    # Only drift checks have the columns from here on. Covariance of (u_c, tau), of which charts show the deviations.
    covariance: Mapped[Sequence[Sequence[float]] | None] = mapped_column(JSON(none_as_null=True))
    method: Mapped[str | None] = mapped_column(String(20))
    # Change against the baseline, where the check had one.
    baseline_checks: Mapped[int | None]
    baseline_age_hours: Mapped[float | None] = mapped_column(Float(53))
    cor_column_baseline_change_mm: Mapped[float | None] = mapped_column(Float(53))
    tilt_baseline_change_rad: Mapped[float | None] = mapped_column(Float(53))
    # The activation in whose chart the check is; null: the check does not count for the scanner's chart.
    activation_number: Mapped[int | None]
    input_sha256: Mapped[str | None] = mapped_column(String(64))
    # True until the check is in the chart, then null.
    awaits_chart: Mapped[bool | None]
    # Mean with the checks before this one, once it is in the chart (`sawmill_store/drift/drift_charts.py`).
    pooled_checks: Mapped[int | None]
    pooled_cor_column_mm: Mapped[float | None] = mapped_column(Float(53))
    pooled_cor_column_standard_deviation_mm: Mapped[float | None] = mapped_column(Float(53))
    pooled_tilt_rad: Mapped[float | None] = mapped_column(Float(53))
    pooled_tilt_standard_deviation_rad: Mapped[float | None] = mapped_column(Float(53))

    # Angles as the contracts `Measurement`, `Movement` and `PooledDrift` have them.
    tilt_deg = _in_degrees("tilt_rad")
    tilt_standard_deviation_deg = _in_degrees("tilt_standard_deviation_rad")
    tilt_change_deg = _in_degrees("tilt_change_rad")
    tilt_baseline_change_deg = _in_degrees("tilt_baseline_change_rad")
    pooled_tilt_deg = _in_degrees("pooled_tilt_rad")
    pooled_tilt_standard_deviation_deg = _in_degrees("pooled_tilt_standard_deviation_rad")

    @property
    def cor_column_tilt_covariance_mm_deg(self) -> float | None:
        """Covariance of u_c and tau, as the contract `Measurement` has it."""
        return None if self.covariance is None else math.degrees(self.covariance[0][1])

    @property
    def calibrated(self) -> tuple[float, float]:
        """Calibrated (u_c, tau), from which the changes are counted; the measured values where there is no change."""
        return self.cor_column_mm - (self.cor_column_change_mm or 0.0), self.tilt_rad - (self.tilt_change_rad or 0.0)


class DriftChartRow(Base):
    """The chart of a scanner's drift checks by one method since its newest activation."""

    __tablename__ = "drift_charts"

    scanner_id: Mapped[str] = mapped_column(ForeignKey("scanners.id", ondelete="CASCADE"), primary_key=True)
    method: Mapped[str] = mapped_column(String(20), primary_key=True)
    activation_number: Mapped[int]
    # State of the chart (`tomography/drift_chart`), number of drift checks in it, and end of the newest check.
    state: Mapped[Json]
    looks: Mapped[int]
    changed_at: Mapped[datetime]
    baseline: Mapped[Json | None]
    finding: Mapped[Json]
    # The finding that opened the alarm, kept until another calibration is active.
    alarm: Mapped[Json | None]


class ScheduleRow(Resource):
    """A schedule of calibrations or drift checks; `next_due_at` is null when disabled."""

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
    # True if the last due time was missed and announced: the next missed ones are not announced.
    missed: Mapped[bool] = mapped_column(default=False)


class ScheduleRunRow(Base):
    """The outcome of one due time; the constraint allows one row for each due time."""

    __tablename__ = "schedule_runs"
    __table_args__ = (UniqueConstraint("schedule_id", "due_at"),)

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    schedule_id: Mapped[str] = mapped_column(ForeignKey("schedules.id", ondelete="CASCADE"))
    due_at: Mapped[datetime]
    outcome: Mapped[str] = mapped_column(String(40))
    calibration_id: Mapped[str | None] = mapped_column(ForeignKey("calibrations.id"), index=True)
    drift_id: Mapped[str | None] = mapped_column(String(64))


class AlarmRow(Base):
    """An open alarm; the key allows one alarm of each sort for a scanner."""

    __tablename__ = "alarms"

    scanner_id: Mapped[str] = mapped_column(ForeignKey("scanners.id", ondelete="CASCADE"), primary_key=True)
    kind: Mapped[AlarmKind] = mapped_column(primary_key=True)
    since: Mapped[datetime]
    last_at: Mapped[datetime | None]
    limit_hours: Mapped[float | None] = mapped_column(Float(53))
    phantom_id: Mapped[str | None] = mapped_column(String(64))
    expired_on: Mapped[date | None]
    drift: Mapped[Json | None]
    acknowledged: Mapped[Json | None]


class RetentionRow(Base):
    """The one row of the rules of retention, with the number of removals so far, by kind."""

    __tablename__ = "retention"

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    rules: Mapped[Json]
    # Number that grows with each change of the rules.
    revision: Mapped[int]
    changed_at: Mapped[datetime]
    changed_by: Mapped[str] = mapped_column(String(200))
    # Time when days were last counted; null: not since the change.
    followed_at: Mapped[datetime | None]
    removed: Mapped[Json]
