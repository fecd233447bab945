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

from sawmill_store.migrations.columns import (
    BYTES,
    EVENT,
    FLAG,
    ID,
    INTEGER,
    JSON,
    MOMENT,
    NAME,
    REAL,
    TEXT,
    WORD,
    counted,
    keys,
    needed,
    perhaps,
    single,
    unique,
)

revision = "0022"
down_revision = "0003"
branch_labels = None
depends_on = None

Values = dict[str, Any]

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
    with op.batch_alter_table("drifts") as drifts:  # a drift check may have an imported geometry instead
        drifts.alter_column("calibration_id", existing_type=ID, nullable=True)
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


def _change_tables_of_jobs() -> None:
    """Count losses and heartbeats; keep why a job waits, its lane, priority, group, and whose request queued it.

    The two tables of a row each are the time and the identity of the data folder that workers go by.
    """
    for column in (
        *(sa.Column(name, INTEGER, nullable=False, server_default="0") for name in ("losses", "outages")),
        *perhaps(not_before_s=REAL, waiting_for=JSON),
        sa.Column("beats", INTEGER, nullable=False, server_default="0"),
        sa.Column("short", FLAG, nullable=False, server_default=sa.false()),
        sa.Column("priority", INTEGER, nullable=False, server_default="0"),
        sa.Column("group_id", ID, nullable=False, server_default=""),
        *perhaps(output_sha256=ID, request_id=ID, key_id=ID, asked_by=NAME),
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
        *needed(short_only=FLAG),
        sa.Column("priority", INTEGER, autoincrement=False, nullable=False),
        *needed(group_id=ID, turn=BYTES),
        *keys("job_turns", "short_only", "priority", "group_id"),
    )
    op.create_table("clock", single(), *needed(boot=ID, offset_s=REAL), *keys("clock", "number"))
    op.create_table("data_folder", single(), *needed(identity=ID), *keys("data_folder", "number"))


def _change_tables_of_schedules() -> None:
    """Have schedules with a time zone, and those of drift checks; keep whether the last due time was missed."""
    for column in (
        sa.Column("time_zone", ID, nullable=False, server_default="UTC"),
        sa.Column("kind", WORD, nullable=False, server_default="recalibrate"),
        sa.Column("drift_options", JSON, nullable=False, server_default='{"rows": null}'),
        sa.Column("missed", FLAG, nullable=False, server_default=sa.false()),
    ):
        op.add_column("schedules", column)
    op.add_column("schedule_runs", sa.Column("drift_id", ID, nullable=True))


def _number_logs() -> None:
    """Number each scanner's logs from the first on; the reconstructions of one scan show the same log."""
    op.add_column("reconstructions", sa.Column("number", INTEGER, nullable=False, server_default="0"))
    op.add_column("reconstructions", sa.Column("name", NAME, nullable=True))
    op.add_column("reconstructions", sa.Column("marks", JSON, nullable=False, server_default="[]"))
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
        *perhaps(scanner_id=ID, scan_id=ID, phantom_id=ID, calibration_id=ID),
        *needed(options=JSON),
        *perhaps(result=JSON),
        *needed(job_id=ID, id=ID, created_at=MOMENT),
        *keys("asked", "id", calibration_id="calibrations", job_id="jobs"),
        unique("asked", "job_id"),
    )


def _create_events() -> sa.Table:
    """Create the ledger, of which the database itself refuses to change or remove a decision."""
    events = op.create_table(
        "events",
        counted(),
        *needed(at=MOMENT),
        sa.Column("class", WORD, nullable=False),
        *needed(type=EVENT),
        *perhaps(topic=WORD, group_id=ID, subject=WORD, subject_id=ID),
        *perhaps(job_id=ID, attempt=INTEGER, worker=NAME),
        *perhaps(who=NAME, key_id=ID, address=ID, request_id=ID, why=TEXT, detail=JSON, decided=JSON),
        *keys("events", "number"),
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
        *needed(id=ID, created_at=MOMENT, name=NAME, scope=WORD, display=FLAG, secret_hash=ID),
        *perhaps(previous_hash=ID, previous_until=MOMENT, rotated_at=MOMENT),
        *perhaps(expires_at=MOMENT, revoked_at=MOMENT, last_used_at=MOMENT),
        *needed(created_by=NAME),
        *keys("keys", "id"),
    )
    op.create_table(
        "sessions",
        *needed(secret_hash=ID, opened_by_hash=ID, created_at=MOMENT),
        *perhaps(expires_at=MOMENT),
        *keys("sessions", "secret_hash"),
    )


def _create_tables_of_requests() -> None:
    """Create the answers of repeated requests, the uploads that can be resumed, and the rules of retention."""
    op.create_table(
        "repeats",
        *needed(caller=NAME, key=NAME, created_at=MOMENT, request_sha256=ID),
        *perhaps(file_sha256=ID, answer=JSON),
        *keys("repeats", "caller", "key"),
    )
    op.create_table(
        "uploads",
        *needed(id=ID, created_at=MOMENT),
        *perhaps(name=NAME, key_id=ID),
        *needed(size_bytes=BYTES, offset_bytes=BYTES),
        *perhaps(sha256=ID),
        *needed(state=WORD),
        *perhaps(used_by=NAME),
        *needed(changed_at=MOMENT),
        *keys("uploads", "id"),
    )
    op.create_table(
        "retention",
        single(),
        *needed(rules=JSON, revision=INTEGER, changed_at=MOMENT, changed_by=NAME, removed=JSON),
        *perhaps(followed_at=MOMENT),
        *keys("retention", "number"),
    )


def _create_tables_of_webhooks() -> None:
    """Create the webhooks, what was delivered to them, and which process sends."""
    secret = sa.String(length=100)
    op.create_table(
        "webhooks",
        *needed(id=ID, created_at=MOMENT, url=sa.String(length=2000)),
        *perhaps(description=NAME),
        *needed(events=JSON, enabled=FLAG, paused=FLAG, secret=secret),
        *perhaps(previous_secret=secret, previous_secret_until=MOMENT),
        *needed(after=INTEGER, delivered=INTEGER, failed=INTEGER, failures=INTEGER),
        *perhaps(next_attempt_at=MOMENT, last_success_at=MOMENT, last_failure_at=MOMENT, last_failure=TEXT),
        *keys("webhooks", "id"),
    )
    op.create_table(
        "webhook_deliveries",
        counted(),
        *needed(webhook_id=ID, event_number=INTEGER, message_id=ID, type=EVENT, state=WORD, attempts=INTEGER),
        *needed(first_at=MOMENT, last_at=MOMENT),
        *perhaps(status=INTEGER, reason=TEXT),
        *keys("webhook_deliveries", "number", cascades=["webhook_id"], webhook_id="webhooks"),
        unique("webhook_deliveries", "webhook_id", "event_number"),
    )
    op.create_table(
        "webhook_sender",
        single(),
        *needed(holder=ID, held_until=MOMENT),
        *keys("webhook_sender", "number"),
    )


def _create_tables_of_alarms() -> None:
    """Create the alarms, and the drift chart of each scanner and method."""
    op.create_table(
        "alarms",
        *needed(scanner_id=ID, kind=EVENT, since=MOMENT),
        *perhaps(last_at=MOMENT, limit_hours=REAL, phantom_id=ID, expired_on=sa.Date(), drift=JSON),
        *perhaps(acknowledged=JSON),
        *keys("alarms", "scanner_id", "kind", cascades=["scanner_id"], scanner_id="scanners"),
    )
    op.create_table(
        "drift_charts",
        *needed(scanner_id=ID, method=WORD, activation_number=INTEGER, state=JSON, looks=INTEGER),
        *needed(changed_at=MOMENT),
        *perhaps(baseline=JSON),
        *needed(finding=JSON),
        *perhaps(alarm=JSON),
        *keys("drift_charts", "scanner_id", "method", cascades=["scanner_id"], scanner_id="scanners"),
    )


def _create_measurements() -> sa.Table:
    """Create what calibrations and drift checks measured, a row for each."""
    return op.create_table(
        "measurements",
        counted(),
        *needed(scanner_id=ID, at=MOMENT, kind=WORD, subject_id=ID),
        *perhaps(against_id=ID, within_tolerance=FLAG, verdict=WORD, rays_verdict=WORD),
        *perhaps(ray_change_mm=REAL, ray_change_tolerance_mm=REAL, scale_change_percent=REAL),
        *needed(cor_column_mm=REAL),
        *perhaps(cor_column_change_mm=REAL),
        *needed(tilt_rad=REAL),
        *perhaps(tilt_change_rad=REAL),
        *needed(source_to_detector_mm=REAL),
        *perhaps(source_distance_mm=REAL),
        *needed(relative_residual=REAL),
        *perhaps(gain=REAL, ray_error_rms_mm=REAL, ray_error_upper_95_mm=REAL, scale_uncertainty_percent=REAL),
        *perhaps(cor_column_standard_deviation_mm=REAL, tilt_standard_deviation_rad=REAL),
        *perhaps(source_to_detector_standard_deviation_mm=REAL),
        *perhaps(covariance=JSON, baseline_age_hours=REAL),
        *perhaps(cor_column_baseline_change_mm=REAL, tilt_baseline_change_rad=REAL),
        *perhaps(pooled_cor_column_mm=REAL, pooled_cor_column_standard_deviation_mm=REAL),
        *perhaps(pooled_tilt_rad=REAL, pooled_tilt_standard_deviation_rad=REAL),
        *perhaps(baseline_checks=INTEGER, activation_number=INTEGER, pooled_checks=INTEGER),
        *perhaps(method=WORD, input_sha256=ID, awaits_chart=FLAG),
        *keys("measurements", "number", scanner_id="scanners"),
    )


def _table(name: str, **types: TypeEngine[Any]) -> sa.TableClause:
    return sa.table(name, *(sa.column(column, kind) for column, kind in types.items()))


_JOBS = _table("jobs", id=ID, state=WORD, created_at=MOMENT, finished_at=MOMENT, failure=JSON)
_ASKED = {
    "calibration": _table("calibrations", id=ID, scanner_id=ID, job_id=ID, schedule_id=ID, result=JSON),
    "drift": _table("drifts", id=ID, scanner_id=ID, job_id=ID, calibration_id=ID, result=JSON),
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
        "activations", number=INTEGER, scanner_id=ID, calibration_id=ID, reason=TEXT, activated_at=MOMENT
    )
    seen = set()
    for row in op.get_bind().execute(sa.select(activations).order_by(activations.c.number)):
        again = (row.scanner_id, row.calibration_id) in seen
        seen.add((row.scanner_id, row.calibration_id))
        what = "calibration-rolled-back" if again else "calibration-activated"
        entry = _entry(row.scanner_id, row.activated_at, "activation", what, "calibration", row.calibration_id)
        yield entry | {"why": row.reason}
