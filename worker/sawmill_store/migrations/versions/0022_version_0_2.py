"""Tables of version 0.2.0, from those of 0.1.0 (revision 0003); measurements and histories are filled from its answers.

Until 0.2.0 is released, a change of the tables is made in this file. The numbers 0004 to 0021 belonged to states that
no release had: databases of those are refused.
"""

import math
from collections.abc import Iterator
from datetime import datetime
from typing import Any

import sqlalchemy as sa
from alembic import op
from sqlalchemy.types import TypeEngine

revision = "0022"
down_revision = "0003"
branch_labels = None
depends_on = None

Columns = list[sa.Column[Any]]
Values = dict[str, Any]

_ID = sa.String(length=64)
_WORD = sa.String(length=20)
_EVENT = sa.String(length=40)
_NAME = sa.String(length=200)
_TEXT = sa.String()
_MOMENT = sa.DateTime(timezone=True)
_REAL = sa.Float(precision=53)
_INTEGER = sa.Integer()
_BYTES = sa.BigInteger()
_FLAG = sa.Boolean()
_JSON = sa.JSON()

_INDEXES = {
    "ix_jobs_created_at_id": ("jobs", ["created_at", "id"], None),
    "ix_jobs_queue": ("jobs", ["state", "priority", "group_id", "created_at", "id", "short", "kind"], None),
    "ix_jobs_places": ("jobs", ["state", "priority", "short", "kind", "created_at", "id"], None),
    "ix_jobs_queued_of_key": ("jobs", ["key_id"], "state = 'queued'"),
    "ix_asked_scanner_id": ("asked", ["scanner_id"], None),
    "ix_asked_scan_id": ("asked", ["scan_id"], None),
    "ix_asked_phantom_id": ("asked", ["phantom_id"], None),
    "ix_asked_created_at_id": ("asked", ["created_at", "id"], None),
    "ix_events_job_id": ("events", ["job_id"], None),
    "ix_events_group_id_number": ("events", ["group_id", "number"], None),
    "ix_events_history": ("events", ["group_id", "at", "number"], "topic IS NOT NULL"),
    "ix_events_history_topic": ("events", ["group_id", "topic", "at", "number"], "topic IS NOT NULL"),
    "ix_events_decisions": ("events", ["number"], "class = 'decision'"),
    "ix_events_removable": ("events", ["number"], "class = 'work' AND topic IS NULL"),
    "ix_measurements_subject_id": ("measurements", ["subject_id"], None),
    "ix_events_type_number": ("events", ["type", "number"], None),
    "ix_keys_previous_hash": ("keys", ["previous_hash"], None),
    "ix_measurements_at": ("measurements", ["at"], None),
    "ix_measurements_scanner_id_number": ("measurements", ["scanner_id", "number"], None),
    "ix_measurements_scanner_id_at": ("measurements", ["scanner_id", "at"], None),
    "ix_measurements_looks": (
        "measurements",
        ["activation_number", "method", "number"],
        "activation_number IS NOT NULL",
    ),
    "ix_measurements_counted": (
        "measurements",
        ["activation_number", "method", "input_sha256"],
        "activation_number IS NOT NULL",
    ),
    "ix_measurements_awaiting_chart": ("measurements", ["scanner_id", "number"], "awaits_chart IS NOT NULL"),
    "ix_repeats_created_at": ("repeats", ["created_at"], None),
    "ix_uploads_changed_at": ("uploads", ["changed_at"], None),
    "ix_webhook_deliveries_last_at": ("webhook_deliveries", ["last_at"], None),
    "ix_drifts_created_at_id": ("drifts", ["created_at", "id"], None),
    "ix_scans_of_phantoms": ("scans", ["scanner_id", "created_at"], "phantom_id IS NOT NULL"),
    "ix_scans_phantom_id": ("scans", ["phantom_id"], "phantom_id IS NOT NULL"),
    # Those that rules of retention go by.
    "ix_scans_logs_by_age": ("scans", ["created_at", "id"], "phantom_id IS NULL"),
    "ix_scans_phantoms_by_age": ("scans", ["created_at", "id"], "phantom_id IS NOT NULL"),
    "ix_calibrations_by_age": ("calibrations", ["created_at", "id"], None),
    "ix_reconstructions_by_age": ("reconstructions", ["created_at", "id"], None),
    # Without these, each row that is removed costs a walk through whatever may refer to it.
    "ix_scans_job_id": ("scans", ["job_id"], None),
    "ix_phantoms_job_id": ("phantoms", ["job_id"], None),
    "ix_asked_calibration_id": ("asked", ["calibration_id"], None),
    "ix_reconstructions_calibration_id": ("reconstructions", ["calibration_id"], None),
    "ix_drifts_calibration_id": ("drifts", ["calibration_id"], None),
    "ix_activations_calibration_id": ("activations", ["calibration_id"], None),
    "ix_schedule_runs_calibration_id": ("schedule_runs", ["calibration_id"], None),
}


def upgrade() -> None:
    # The version of the program that made the tables; `Database.upgrade` writes it.
    op.add_column("alembic_version", sa.Column("product_version", sa.String(length=40), nullable=True))
    _change_tables_of_jobs()
    _change_tables_of_schedules()
    _number_logs()
    _create_asked()
    _create_tables_of_keys()
    _create_tables_of_requests()
    _create_tables_of_webhooks()
    _create_tables_of_alarms()
    measurements, events = _create_measurements(), _create_events()
    op.drop_index("ix_scans_phantom_id", "scans")
    for name, (table, columns, which) in _INDEXES.items():
        where = None if which is None else sa.text(which)
        op.create_index(name, table, columns, sqlite_where=where, postgresql_where=where)
    op.create_index("ix_keys_secret_hash", "keys", ["secret_hash"], unique=True)
    entries = [*_measured(measurements), *_without_result(), *_activations()]
    entries.sort(key=lambda entry: entry["at"])
    op.bulk_insert(events, entries)


def _needed(**types: TypeEngine[Any]) -> Columns:
    return [sa.Column(name, kind, nullable=False) for name, kind in types.items()]


def _perhaps(**types: TypeEngine[Any]) -> Columns:
    return [sa.Column(name, kind, nullable=True) for name, kind in types.items()]


def _counted() -> sa.Column[Any]:
    """The number of a row, which the database gives."""
    return sa.Column("number", _INTEGER, autoincrement=True, nullable=False)


def _single() -> sa.Column[Any]:
    """The number of a table's only row."""
    return sa.Column("number", _INTEGER, autoincrement=False, nullable=False)


def _change_tables_of_jobs() -> None:
    """Count losses and heartbeats; keep why a job waits, its lane, priority, group, and whose request queued it.

    The two tables of a row each are the time and the identity of the data folder that workers go by.
    """
    for column in (
        *(sa.Column(name, _INTEGER, nullable=False, server_default="0") for name in ("losses", "outages")),
        *_perhaps(not_before_s=_REAL, waiting_for=_JSON),
        sa.Column("beats", _INTEGER, nullable=False, server_default="0"),
        sa.Column("short", _FLAG, nullable=False, server_default=sa.false()),
        sa.Column("priority", _INTEGER, nullable=False, server_default="0"),
        sa.Column("group_id", _ID, nullable=False, server_default=""),
        *_perhaps(output_sha256=_ID, request_id=_ID, key_id=_ID, asked_by=_NAME),
    ):
        op.add_column("jobs", column)
    for table in ("scans", "calibrations", "reconstructions", "drifts", "plans"):
        op.execute(
            f"UPDATE jobs SET group_id = (SELECT scanner_id FROM {table} WHERE {table}.job_id = jobs.id)"  # noqa: S608
            f" WHERE EXISTS (SELECT 1 FROM {table} WHERE {table}.job_id = jobs.id)"
        )
    op.drop_column("jobs", "lease_expires_s")
    op.create_table(
        "job_turns",
        *_needed(short_only=_FLAG),
        sa.Column("priority", _INTEGER, autoincrement=False, nullable=False),
        *_needed(group_id=_ID, turn=_BYTES),
        sa.PrimaryKeyConstraint("short_only", "priority", "group_id", name="pk_job_turns"),
    )
    op.create_table(
        "clock", _single(), *_needed(boot=_ID, offset_s=_REAL), sa.PrimaryKeyConstraint("number", name="pk_clock")
    )
    op.create_table(
        "data_folder", _single(), *_needed(identity=_ID), sa.PrimaryKeyConstraint("number", name="pk_data_folder")
    )


def _change_tables_of_schedules() -> None:
    """Have schedules with a time zone, and those of drift checks; keep whether the last due time was missed."""
    for column in (
        sa.Column("time_zone", _ID, nullable=False, server_default="UTC"),
        sa.Column("kind", _WORD, nullable=False, server_default="recalibrate"),
        sa.Column("drift_options", _JSON, nullable=False, server_default='{"rows": null}'),
        sa.Column("missed", _FLAG, nullable=False, server_default=sa.false()),
    ):
        op.add_column("schedules", column)
    op.add_column("schedule_runs", sa.Column("drift_id", _ID, nullable=True))


def _number_logs() -> None:
    """Number each scanner's logs from the first on; the reconstructions of one scan show the same log."""
    op.add_column("reconstructions", sa.Column("number", _INTEGER, nullable=False, server_default="0"))
    op.add_column("reconstructions", sa.Column("name", _NAME, nullable=True))
    op.add_column("reconstructions", sa.Column("marks", _JSON, nullable=False, server_default="[]"))
    numbers: dict[str, dict[str, int]] = {}
    ordered = "SELECT id, scanner_id, scan_id FROM reconstructions ORDER BY created_at, id"
    for identifier, scanner_id, scan_id in op.get_bind().execute(sa.text(ordered)).all():
        of_scanner = numbers.setdefault(scanner_id, {})
        number = of_scanner.setdefault(scan_id, len(of_scanner) + 1)
        values = {"number": number, "id": identifier}
        op.get_bind().execute(sa.text("UPDATE reconstructions SET number = :number WHERE id = :id"), values)


def _create_asked() -> None:
    """Create one table for all kinds of jobs that are asked for and came after the first versions."""
    op.create_table(
        "asked",
        *_perhaps(scanner_id=_ID, scan_id=_ID, phantom_id=_ID, calibration_id=_ID),
        *_needed(options=_JSON),
        *_perhaps(result=_JSON),
        *_needed(job_id=_ID, id=_ID, created_at=_MOMENT),
        sa.ForeignKeyConstraint(["calibration_id"], ["calibrations.id"], name="fk_asked_calibration_id"),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name="fk_asked_job_id"),
        sa.PrimaryKeyConstraint("id", name="pk_asked"),
        sa.UniqueConstraint("job_id", name="uq_asked_job_id"),
    )


def _create_events() -> sa.Table:
    """Create the ledger, of which the database itself refuses to change or remove a decision."""
    events = op.create_table(
        "events",
        _counted(),
        *_needed(at=_MOMENT),
        sa.Column("class", _WORD, nullable=False),
        *_needed(type=_EVENT),
        *_perhaps(topic=_WORD, group_id=_ID, subject=_WORD, subject_id=_ID),
        *_perhaps(job_id=_ID, attempt=_INTEGER, worker=_NAME),
        *_perhaps(who=_NAME, key_id=_ID, address=_ID, request_id=_ID, why=_TEXT, detail=_JSON, decided=_JSON),
        sa.PrimaryKeyConstraint("number", name="pk_events"),
    )
    if op.get_bind().dialect.name == "sqlite":
        refused = "BEGIN SELECT RAISE(ABORT, 'decisions of the ledger stay as they are'); END"
        for change in ("UPDATE", "DELETE"):
            op.execute(
                f"CREATE TRIGGER decisions_no_{change.lower()} BEFORE {change} ON events"
                f" WHEN OLD.class = 'decision' {refused}"
            )
        there = "EXISTS (SELECT 1 FROM events WHERE number = NEW.number AND class = 'decision')"
        op.execute(f"CREATE TRIGGER decisions_no_replace BEFORE INSERT ON events WHEN {there} {refused}")
        return events
    op.execute(
        "CREATE FUNCTION decisions_stay() RETURNS trigger LANGUAGE plpgsql AS"
        " $$ BEGIN RAISE EXCEPTION 'decisions of the ledger stay as they are'; END $$"
    )
    op.execute(
        "CREATE TRIGGER decisions_stay BEFORE UPDATE OR DELETE ON events"
        " FOR EACH ROW WHEN (OLD.class = 'decision') EXECUTE FUNCTION decisions_stay()"
    )
    op.execute(
        "CREATE TRIGGER decisions_no_truncate BEFORE TRUNCATE ON events"
        " FOR EACH STATEMENT EXECUTE FUNCTION decisions_stay()"
    )
    return events


def _create_tables_of_keys() -> None:
    """Create the keys, and the sessions that they open."""
    op.create_table(
        "keys",
        *_needed(id=_ID, created_at=_MOMENT, name=_NAME, scope=_WORD, display=_FLAG, secret_hash=_ID),
        *_perhaps(previous_hash=_ID, previous_until=_MOMENT, rotated_at=_MOMENT),
        *_perhaps(expires_at=_MOMENT, revoked_at=_MOMENT, last_used_at=_MOMENT),
        *_needed(created_by=_NAME),
        sa.PrimaryKeyConstraint("id", name="pk_keys"),
    )
    op.create_table(
        "sessions",
        *_needed(secret_hash=_ID, opened_by_hash=_ID, created_at=_MOMENT),
        *_perhaps(expires_at=_MOMENT),
        sa.PrimaryKeyConstraint("secret_hash", name="pk_sessions"),
    )


def _create_tables_of_requests() -> None:
    """Create the answers of repeated requests, the uploads that can be resumed, and the rules of retention."""
    op.create_table(
        "repeats",
        *_needed(caller=_NAME, key=_NAME, created_at=_MOMENT, request_sha256=_ID),
        *_perhaps(file_sha256=_ID, answer=_JSON),
        sa.PrimaryKeyConstraint("caller", "key", name="pk_repeats"),
    )
    op.create_table(
        "uploads",
        *_needed(id=_ID, created_at=_MOMENT),
        *_perhaps(name=_NAME, key_id=_ID),
        *_needed(size_bytes=_BYTES, offset_bytes=_BYTES),
        *_perhaps(sha256=_ID),
        *_needed(state=_WORD),
        *_perhaps(used_by=_NAME),
        *_needed(changed_at=_MOMENT),
        sa.PrimaryKeyConstraint("id", name="pk_uploads"),
    )
    op.create_table(
        "retention",
        _single(),
        *_needed(rules=_JSON, revision=_INTEGER, changed_at=_MOMENT, changed_by=_NAME, removed=_JSON),
        *_perhaps(followed_at=_MOMENT),
        sa.PrimaryKeyConstraint("number", name="pk_retention"),
    )


def _create_tables_of_webhooks() -> None:
    """Create the webhooks, what was delivered to them, and which process sends."""
    secret = sa.String(length=100)
    op.create_table(
        "webhooks",
        *_needed(id=_ID, created_at=_MOMENT, url=sa.String(length=2000)),
        *_perhaps(description=_NAME),
        *_needed(events=_JSON, enabled=_FLAG, paused=_FLAG, secret=secret),
        *_perhaps(previous_secret=secret, previous_secret_until=_MOMENT),
        *_needed(after=_INTEGER, delivered=_INTEGER, failed=_INTEGER, failures=_INTEGER),
        *_perhaps(next_attempt_at=_MOMENT, last_success_at=_MOMENT, last_failure_at=_MOMENT, last_failure=_TEXT),
        sa.PrimaryKeyConstraint("id", name="pk_webhooks"),
    )
    op.create_table(
        "webhook_deliveries",
        _counted(),
        *_needed(webhook_id=_ID, event_number=_INTEGER, message_id=_ID, type=_EVENT, state=_WORD, attempts=_INTEGER),
        *_needed(first_at=_MOMENT, last_at=_MOMENT),
        *_perhaps(status=_INTEGER, reason=_TEXT),
        sa.ForeignKeyConstraint(
            ["webhook_id"], ["webhooks.id"], name="fk_webhook_deliveries_webhook_id", ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("number", name="pk_webhook_deliveries"),
        sa.UniqueConstraint("webhook_id", "event_number", name="uq_webhook_deliveries_webhook_id_event_number"),
    )
    op.create_table(
        "webhook_sender",
        _single(),
        *_needed(holder=_ID, held_until=_MOMENT),
        sa.PrimaryKeyConstraint("number", name="pk_webhook_sender"),
    )


def _create_tables_of_alarms() -> None:
    """Create the alarms, and the drift chart of each scanner and method."""
    op.create_table(
        "alarms",
        *_needed(scanner_id=_ID, kind=_EVENT, since=_MOMENT),
        *_perhaps(last_at=_MOMENT, limit_hours=_REAL, phantom_id=_ID, expired_on=sa.Date(), drift=_JSON),
        *_perhaps(acknowledged=_JSON),
        sa.ForeignKeyConstraint(["scanner_id"], ["scanners.id"], name="fk_alarms_scanner_id", ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("scanner_id", "kind", name="pk_alarms"),
    )
    op.create_table(
        "drift_charts",
        *_needed(scanner_id=_ID, method=_WORD, activation_number=_INTEGER, state=_JSON, looks=_INTEGER),
        *_needed(changed_at=_MOMENT),
        *_perhaps(baseline=_JSON),
        *_needed(finding=_JSON),
        *_perhaps(alarm=_JSON),
        sa.ForeignKeyConstraint(["scanner_id"], ["scanners.id"], name="fk_drift_charts_scanner_id", ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("scanner_id", "method", name="pk_drift_charts"),
    )


def _create_measurements() -> sa.Table:
    """Create what calibrations and drift checks measured, a row for each."""
    return op.create_table(
        "measurements",
        _counted(),
        *_needed(scanner_id=_ID, at=_MOMENT, kind=_WORD, subject_id=_ID),
        *_perhaps(against_id=_ID, within_tolerance=_FLAG, verdict=_WORD, rays_verdict=_WORD),
        *_perhaps(ray_change_mm=_REAL, ray_change_tolerance_mm=_REAL, scale_change_percent=_REAL),
        *_needed(cor_column_mm=_REAL),
        *_perhaps(cor_column_change_mm=_REAL),
        *_needed(tilt_rad=_REAL),
        *_perhaps(tilt_change_rad=_REAL),
        *_needed(source_to_detector_mm=_REAL),
        *_perhaps(source_distance_mm=_REAL),
        *_needed(relative_residual=_REAL),
        *_perhaps(gain=_REAL, ray_error_rms_mm=_REAL, ray_error_upper_95_mm=_REAL, scale_uncertainty_percent=_REAL),
        *_perhaps(cor_column_standard_deviation_mm=_REAL, tilt_standard_deviation_rad=_REAL),
        *_perhaps(source_to_detector_standard_deviation_mm=_REAL),
        *_perhaps(covariance=_JSON, baseline_age_hours=_REAL),
        *_perhaps(cor_column_baseline_change_mm=_REAL, tilt_baseline_change_rad=_REAL),
        *_perhaps(pooled_cor_column_mm=_REAL, pooled_cor_column_standard_deviation_mm=_REAL),
        *_perhaps(pooled_tilt_rad=_REAL, pooled_tilt_standard_deviation_rad=_REAL),
        *_perhaps(baseline_checks=_INTEGER, activation_number=_INTEGER, pooled_checks=_INTEGER),
        *_perhaps(method=_WORD, input_sha256=_ID, awaits_chart=_FLAG),
        sa.ForeignKeyConstraint(["scanner_id"], ["scanners.id"], name="fk_measurements_scanner_id"),
        sa.PrimaryKeyConstraint("number", name="pk_measurements"),
    )


def _table(name: str, **types: TypeEngine[Any]) -> sa.TableClause:
    return sa.table(name, *(sa.column(column, kind) for column, kind in types.items()))


_JOBS = _table("jobs", id=_ID, state=_WORD, created_at=_MOMENT, finished_at=_MOMENT, failure=_JSON)
_ASKED = {
    "calibration": _table("calibrations", id=_ID, scanner_id=_ID, job_id=_ID, schedule_id=_ID, result=_JSON),
    "drift": _table("drifts", id=_ID, scanner_id=_ID, job_id=_ID, calibration_id=_ID, result=_JSON),
}
_KINDS = {"calibration": "calibration", "drift": "drift-check"}


def _entry(scanner_id: str, at: datetime, topic: str, what: str, subject: str, subject_id: str) -> Values:
    """Return an event of a history, without who did it and why."""
    about = {"group_id": scanner_id, "at": at, "class": "work", "topic": topic, "type": what, "subject": subject}
    return about | {"subject_id": subject_id} | dict.fromkeys(("who", "why"))


def _schedule_of(row: Any) -> str | None:  # noqa: ANN401 - a row
    """Return the schedule that asked for a calibration; who asked otherwise is not known, nor for a drift check."""
    identifier = getattr(row, "schedule_id", None)
    return None if identifier is None else f"schedule {identifier}"


def _measured(measurements: sa.Table) -> Iterator[Values]:
    """Write a measurement for each answer, in the order in which they ended; yield the entries of the histories."""
    connection = op.get_bind()
    ended_at = sa.func.coalesce(_JOBS.c.finished_at, _JOBS.c.created_at).label("at")
    ended = sa.union_all(
        *(
            sa.select(sa.literal(subject).label("subject"), table.c.id, ended_at)
            .join(_JOBS, _JOBS.c.id == table.c.job_id)
            .where(_JOBS.c.state == "succeeded")
            for subject, table in _ASKED.items()
        )
    ).subquery()
    for subject, identifier, at in connection.execute(sa.select(ended).order_by(ended.c.at, ended.c.id)).all():
        table = _ASKED[subject]
        row = connection.execute(sa.select(table).where(table.c.id == identifier)).one()
        values = _of_calibration(row.result) if subject == "calibration" else _of_drift(row.calibration_id, row.result)
        about = {"scanner_id": row.scanner_id, "at": at, "kind": subject, "subject_id": identifier}
        connection.execute(measurements.insert().values(about | values))
        why = _why(row.result) if subject == "calibration" else row.result["reason"]
        entry = _entry(row.scanner_id, at, _KINDS[subject], "succeeded", subject, identifier)
        yield entry | {"who": _schedule_of(row), "why": why}


def _of_calibration(result: Values) -> Values:
    """Return the columns of a measurement; the tolerance of its comparison does not stand in the answer."""
    frame, change = result["source_frame"], result["comparison"] or {}
    error = result["predicted_ray_error_mm"] or {}
    deviation = (result["standard_deviation"] or {}).get("source_frame") or {}
    return {
        "against_id": change.get("calibration_id"),
        "ray_change_mm": change.get("ray_change_mm"),
        "within_tolerance": change.get("within_tolerance"),
        "cor_column_mm": frame["cor_column_mm"],
        "cor_column_change_mm": change.get("cor_column_change_mm"),
        "tilt_rad": frame["tilt_rad"],
        "tilt_change_rad": math.radians(change["tilt_change_deg"]) if change else None,
        "source_to_detector_mm": frame["source_to_detector_mm"],
        "source_distance_mm": frame["source_distance_mm"],
        "relative_residual": result["residual"]["relative"],
        "gain": result["gain"],
        "ray_error_rms_mm": error.get("rms"),
        "ray_error_upper_95_mm": error.get("upper_95"),
        "verdict": result["verdict"],
    } | _deviations(deviation)


def _of_drift(calibration_id: str, result: Values) -> Values:
    measured, change = result["measured"], result["change"]
    return {
        "against_id": calibration_id,
        "ray_change_mm": result["ray_change_mm"],
        "ray_change_tolerance_mm": result["tolerance_mm"],
        "within_tolerance": result["within_tolerance"],
        "cor_column_mm": measured["cor_column_mm"],
        "cor_column_change_mm": change["cor_column_mm"],
        "tilt_rad": measured["tilt_rad"],
        "tilt_change_rad": change["tilt_rad"],
        "source_to_detector_mm": measured["source_to_detector_mm"],
        "relative_residual": result["relative_residual"],
    } | _deviations(result["standard_deviation"])


def _deviations(deviation: Values) -> Values:
    return {
        "cor_column_standard_deviation_mm": deviation.get("cor_column_mm"),
        "tilt_standard_deviation_rad": deviation.get("tilt_rad"),
        "source_to_detector_standard_deviation_mm": deviation.get("source_to_detector_mm"),
    }


def _why(result: Values) -> str | None:
    compared = (result["comparison"] or {}).get("reason")
    return "; ".join(each for each in (*result["reasons"], compared) if each) or None


def _without_result() -> Iterator[Values]:
    """Yield an entry for each calibration and drift check that failed or was cancelled."""
    job = (_JOBS.c.state, _JOBS.c.created_at, _JOBS.c.finished_at, _JOBS.c.failure)
    for subject, table in _ASKED.items():
        ended = sa.select(table, *job).join(_JOBS, _JOBS.c.id == table.c.job_id)
        for row in op.get_bind().execute(ended.where(_JOBS.c.state.in_(("failed", "cancelled")))):
            at = row.finished_at or row.created_at
            entry = _entry(row.scanner_id, at, _KINDS[subject], row.state, subject, row.id)
            if row.state == "failed":
                entry |= {"who": _schedule_of(row), "why": (row.failure or {}).get("detail")}
            yield entry


def _activations() -> Iterator[Values]:
    """Yield an entry for each activation; a calibration that is activated again was rolled back to."""
    activations = _table(
        "activations", number=_INTEGER, scanner_id=_ID, calibration_id=_ID, reason=_TEXT, activated_at=_MOMENT
    )
    seen = set()
    for row in op.get_bind().execute(sa.select(activations).order_by(activations.c.number)):
        again = (row.scanner_id, row.calibration_id) in seen
        seen.add((row.scanner_id, row.calibration_id))
        what = "calibration-rolled-back" if again else "calibration-activated"
        entry = _entry(row.scanner_id, row.activated_at, "activation", what, "calibration", row.calibration_id)
        yield entry | {"why": row.reason}
