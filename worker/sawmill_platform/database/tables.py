"""The rows of the job service. Specifications and results are JSON; the columns are for queries."""

from collections.abc import Mapping
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any, ClassVar

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
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

from sawmill_platform.contracts.event_kinds import EventType
from sawmill_platform.contracts.jobs import JobKind, JobState, Priority, RegisteredWord
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.contracts.uploads import UploadState
from sawmill_platform.contracts.webhooks import DeliveryState

Json = dict[str, Any]


class UtcDateTime(TypeDecorator[datetime]):
    """Type of aware datetimes, read as UTC, on databases with and without time zones."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:  # noqa: ARG002
        """Convert to UTC; a naive time is refused."""
        if value is None:
            return None
        if value.tzinfo is None:
            raise ValueError(f"a stored time must carry its time zone: {value!r}")
        return value.astimezone(UTC)

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:  # noqa: ARG002
        """Return the time as UTC."""
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


def seconds_between(dialect: str, start: Any, end: Any) -> ColumnElement[Any]:  # noqa: ANN401 - columns or times
    """Return the seconds from one column to another, as an expression of the database."""
    if dialect == "sqlite":
        return (func.julianday(end) - func.julianday(start)) * 86_400.0
    return func.extract("epoch", end - start)


class Ranked(TypeDecorator[Priority]):
    """A priority, stored as its rank so that the queue's order is the column's."""

    impl = Integer
    cache_ok = True

    def process_bind_param(self, value: Priority | None, dialect: Dialect) -> int | None:  # noqa: ARG002
        """Return the rank of a priority."""
        return None if value is None else value.rank

    def process_result_value(self, value: int | None, dialect: Dialect) -> Priority | None:  # noqa: ARG002
        """Return the priority of a rank."""
        return next((priority for priority in Priority if priority.rank == value), None)


class Registered(TypeDecorator[RegisteredWord]):
    """A registered word, stored as text, so that a new word needs no migration."""

    impl = String
    cache_ok = True

    def __init__(self, kind: type[RegisteredWord], length: int = 20) -> None:
        super().__init__(length)
        self.kind = kind

    def process_bind_param(self, value: RegisteredWord | None, dialect: Dialect) -> str | None:  # noqa: ARG002
        """Return the word, or raise `LookupError` if it is not registered."""
        return None if value is None else str(self.kind.of(value))

    def process_result_value(self, value: str | None, dialect: Dialect) -> RegisteredWord | None:  # noqa: ARG002
        """Return the registered word, or raise `LookupError`."""
        return None if value is None else self.kind.of(value)


def words(kind: type[StrEnum], length: int = 20) -> Enum:
    """Return the type of an enum stored by value in a plain text column, so that a new word needs no migration."""
    return Enum(kind, native_enum=False, length=length, values_callable=lambda words: [word.value for word in words])


class EventClass(StrEnum):
    """Time for which an event is kept: a decision for ever, work until the rules of retention remove it."""

    DECISION = "decision"
    WORK = "work"


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
        DeliveryState: words(DeliveryState),
        EventClass: words(EventClass),
        EventType: Registered(EventType, 40),
        JobKind: Registered(JobKind),
        JobState: words(JobState),
        Priority: Ranked(),
        Scope: words(Scope),
        UploadState: words(UploadState),
    }


class Resource(Base):
    """Columns of every resource."""

    __abstract__ = True

    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    created_at: Mapped[datetime]


def partial_index(name: str | None, condition: str, *columns: str) -> Index:
    """Return the index of the rows that fulfil a condition, written in SQL."""
    return Index(name, *columns, sqlite_where=text(condition), postgresql_where=text(condition))


class JobRow(Resource):
    """The row is the job (docs/understand/architecture.md#jobs)."""

    __tablename__ = "jobs"
    # Lists, all or in one state; claims and places in the queue; counts.
    __table_args__ = (
        Index(None, "created_at", "id"),
        Index(None, "state", "created_at", "id"),
        Index("ix_jobs_queue", "state", "priority", "group_id", "created_at", "id", "short", "kind"),
        Index("ix_jobs_places", "state", "priority", "short", "kind", "created_at", "id"),
        # Jobs of one key (`sawmill_platform/jobs/queue_limits.py`).
        partial_index("ix_jobs_queued_of_key", "state = 'queued'", "key_id"),
    )

    kind: Mapped[JobKind]
    state: Mapped[JobState]
    subject_id: Mapped[str] = mapped_column(String(64), index=True)
    priority: Mapped[Priority] = mapped_column(default=Priority.INTERACTIVE)
    # Whether the job takes seconds: such jobs have a lane in which none waits for a long one.
    short: Mapped[bool] = mapped_column(default=False)
    # Groups take turns (`jobs/wait_estimate.py`); the jobs without a group (empty) are a group as well.
    group_id: Mapped[str] = mapped_column(String(64), default="")
    # Fences attempts: grows with each claim. Losses are counted apart, and so are outages in a row.
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
    # Digest of the file that the job left (`files/verified_results.py`); null: it left none, or is of version 0.1.0.
    output_sha256: Mapped[str | None] = mapped_column(String(64))
    # Id of the request that queued the job; null: no request did.
    request_id: Mapped[str | None] = mapped_column(String(64))
    key_id: Mapped[str | None] = mapped_column(String(64))
    asked_by: Mapped[str | None] = mapped_column(String(200))
    started_at: Mapped[datetime | None]
    finished_at: Mapped[datetime | None]


class JobTurnRow(Base):
    """The turn in which a group was served last, by workers of one lane and at one priority (`wait_estimate.py`)."""

    __tablename__ = "job_turns"

    short_only: Mapped[bool] = mapped_column(primary_key=True)
    priority: Mapped[Priority] = mapped_column(primary_key=True, autoincrement=False)
    group_id: Mapped[str] = mapped_column(String(64), primary_key=True)
    turn: Mapped[int] = mapped_column(BigInteger)


class JobDependencyRow(Base):
    """A dependency: a job may start only when all the jobs that it needs have ended."""

    __tablename__ = "job_dependencies"

    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id"), primary_key=True)
    needs_job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id"), primary_key=True, index=True)


# Rows that the rules of retention may remove, and two kinds of rows that they never remove.
REMOVABLE, IN_HISTORY, DECIDED = "class = 'work' AND topic IS NULL", "topic IS NOT NULL", "class = 'decision'"


class EventRow(Base):
    """The ledger: events, written with the change itself; the database refuses to change a decision.

    The event feed, webhooks, the audit and the histories of groups are queries on this table. `detail` is published,
    `decided` is kept for the audit in addition.
    """

    __tablename__ = "events"
    __table_args__ = (
        Index(None, "group_id", "number"),
        Index(None, "type", "number"),
        partial_index("ix_events_history", IN_HISTORY, "group_id", "at", "number"),
        partial_index("ix_events_history_topic", IN_HISTORY, "group_id", "topic", "at", "number"),
        partial_index("ix_events_decisions", DECIDED, "number"),
        partial_index("ix_events_removable", REMOVABLE, "number"),
    )

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    at: Mapped[datetime]
    event_class: Mapped[EventClass] = mapped_column("class", default=EventClass.WORK)
    type: Mapped[EventType]
    topic: Mapped[str | None] = mapped_column(String(20))
    group_id: Mapped[str | None] = mapped_column(String(64))
    subject: Mapped[str | None] = mapped_column(String(20))
    subject_id: Mapped[str | None] = mapped_column(String(64))
    job_id: Mapped[str | None] = mapped_column(String(64), index=True)
    attempt: Mapped[int | None]
    worker: Mapped[str | None] = mapped_column(String(200))
    who: Mapped[str | None] = mapped_column(String(200))
    key_id: Mapped[str | None] = mapped_column(String(64))
    address: Mapped[str | None] = mapped_column(String(64))
    request_id: Mapped[str | None] = mapped_column(String(64))
    why: Mapped[str | None]
    detail: Mapped[Json | None]
    decided: Mapped[Json | None]


class ClockRow(Base):
    """Seconds from 1970 to the boot of this machine, in one row, on SQLite alone (`database.clock`)."""

    __tablename__ = "clock"

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    boot: Mapped[str] = mapped_column(String(64))
    offset_s: Mapped[float] = mapped_column(Float(53))


class DataFolderRow(Base):
    """Identity of the data folder that has this database's files, in one row (`files/folder_identity.py`)."""

    __tablename__ = "data_folder"

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    identity: Mapped[str] = mapped_column(String(64))


class UploadRow(Resource):
    """An upload that can be resumed; its first `offset_bytes` bytes are on the disk."""

    __tablename__ = "uploads"

    name: Mapped[str | None] = mapped_column(String(200))
    key_id: Mapped[str | None] = mapped_column(String(64))
    size_bytes: Mapped[int] = mapped_column(BigInteger)
    offset_bytes: Mapped[int] = mapped_column(BigInteger)
    sha256: Mapped[str | None] = mapped_column(String(64))
    state: Mapped[UploadState]
    used_by: Mapped[str | None] = mapped_column(String(200))
    changed_at: Mapped[datetime] = mapped_column(index=True)


class KeyRow(Resource):
    """A key, with the hashes of the secret and the secret before, which stays valid for a while after a rotation."""

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
    """Session of a browser that sent a key or the token, whose hash is kept; the session ends with the key or token."""

    __tablename__ = "sessions"

    secret_hash: Mapped[str] = mapped_column(String(64), primary_key=True)
    opened_by_hash: Mapped[str] = mapped_column(String(64))
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime | None]


class WebhookRow(Resource):
    """A webhook with its events; `after` is the number of the last event that is done."""

    __tablename__ = "webhooks"

    url: Mapped[str] = mapped_column(String(2000))
    description: Mapped[str | None] = mapped_column(String(200))
    events: Mapped[list[str]] = mapped_column(JSON)
    enabled: Mapped[bool]
    paused: Mapped[bool] = mapped_column(default=False)
    # In plain text: signing needs it.
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
    """An event that was sent to a webhook; written after the attempt, and removed some days later."""

    __tablename__ = "webhook_deliveries"
    __table_args__ = (UniqueConstraint("webhook_id", "event_number"), Index(None, "last_at"))

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    webhook_id: Mapped[str] = mapped_column(ForeignKey("webhooks.id", ondelete="CASCADE"))
    event_number: Mapped[int]
    message_id: Mapped[str] = mapped_column(String(64))
    type: Mapped[EventType]
    state: Mapped[DeliveryState]
    attempts: Mapped[int]
    first_at: Mapped[datetime]
    last_at: Mapped[datetime]
    status: Mapped[int | None]
    reason: Mapped[str | None]


class SenderRow(Base):
    """The process that sends to webhooks, and the time until which no other one does, in one row."""

    __tablename__ = "webhook_sender"

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    holder: Mapped[str] = mapped_column(String(64))
    held_until: Mapped[datetime]


class RepeatRow(Base):
    """The answer to a request with an `Idempotency-Key`, for repeated requests; `answer` is null until then."""

    __tablename__ = "repeats"

    caller: Mapped[str] = mapped_column(String(200), primary_key=True)
    key: Mapped[str] = mapped_column(String(200), primary_key=True)
    created_at: Mapped[datetime] = mapped_column(index=True)
    # SHA-256 of method, path, query and JSON, and of a file that was sent.
    request_sha256: Mapped[str] = mapped_column(String(64))
    file_sha256: Mapped[str | None] = mapped_column(String(64))
    answer: Mapped[Json | None]
