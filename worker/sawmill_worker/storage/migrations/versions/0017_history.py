"""Histories of scanners, filled from all that is stored; standard deviations of what was measured."""

import math
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0015"
branch_labels = None
depends_on = None

_DEVIATIONS = (
    "cor_column_standard_deviation_mm",
    "tilt_standard_deviation_deg",
    "source_to_detector_standard_deviation_mm",
)
_TEXTS = {"kind": 20, "what": 40, "subject": 20, "subject_id": 64}
_PERHAPS = {"who": 200, "key_id": 64, "why": None, "alarm": 40}
_ABOUT = {
    "alarm-opened": "alarm",
    "alarm-closed": "alarm",
    "scanner-created": "settings",
    "scanner-changed": "settings",
    "schedule-created": "schedule",
    "schedule-changed": "schedule",
    "schedule-deleted": "schedule",
    "schedule-missed": "schedule",
    "scan-refused": "scan",
}
_KINDS = {"calibration": "calibration", "drift": "drift-check"}
_BATCH = 200
_MOMENT = sa.DateTime(timezone=True)

Entry = dict[str, Any]


def upgrade() -> None:
    for name in _DEVIATIONS:
        op.add_column("measurements", sa.Column(name, sa.Float(precision=53), nullable=True))
    history = op.create_table(
        "history",
        sa.Column("number", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("scanner_id", sa.String(length=64), nullable=False),
        sa.Column("at", _MOMENT, nullable=False),
        *(sa.Column(name, sa.String(length=length), nullable=False) for name, length in _TEXTS.items()),
        *(sa.Column(name, sa.String(length=length), nullable=True) for name, length in _PERHAPS.items()),
        sa.Column("measurement_number", sa.Integer(), nullable=True),
        sa.ForeignKeyConstraint(["measurement_number"], ["measurements.number"], name="fk_history_measurement_number"),
        sa.PrimaryKeyConstraint("number", name="pk_history"),
    )
    op.create_index("ix_history_scanner_id_at", "history", ["scanner_id", "at", "number"])
    op.create_index("ix_history_scanner_id_kind_at", "history", ["scanner_id", "kind", "at", "number"])
    entries = [*_measured(), *_without_result(), *_activations(), *_events()]
    entries.sort(key=lambda entry: entry["at"])
    for start in range(0, len(entries), _BATCH):
        op.bulk_insert(history, entries[start : start + _BATCH])


def _table(name: str, *texts: str, **others: Any) -> sa.TableClause:  # noqa: ANN401 - types of columns
    columns = (sa.column(each, sa.String()) for each in texts)
    return sa.table(name, *columns, *(sa.column(each, kind) for each, kind in others.items()))


_JOBS = _table(
    *("jobs", "id", "state", "asked_by", "key_id"), created_at=_MOMENT, finished_at=_MOMENT, failure=sa.JSON()
)
_SCANNERS = _table("scanners", "id")
_AUDIT = _table("audit", "who", "key_id", "subject_id", "action", number=sa.Integer(), at=_MOMENT)
_RUNS = _table("schedule_runs", "schedule_id", "drift_id")
_ASKED = {
    "calibration": _table("calibrations", "id", "scanner_id", "job_id", "schedule_id", result=sa.JSON()),
    "drift": _table("drifts", "id", "scanner_id", "job_id", result=sa.JSON()),
}


def _entry(scanner_id: str, at: datetime, kind: str, what: str, subject: str, subject_id: str) -> Entry:
    nothing = dict.fromkeys((*_PERHAPS, "measurement_number"))
    about = {"kind": kind, "what": what, "subject": subject, "subject_id": subject_id}
    # SQLite has no time zones; all times are UTC.
    in_utc = at.replace(tzinfo=UTC) if at.tzinfo is None else at
    return nothing | {"scanner_id": scanner_id, "at": in_utc} | about


def _asked(subject: str) -> sa.Select[Any]:
    """What was asked for, with its job, and with the schedule that asked for it."""
    table = _ASKED[subject]
    schedule = table.c.schedule_id if subject == "calibration" else _RUNS.c.schedule_id
    asked = sa.select(table, _JOBS.c.asked_by, _JOBS.c.key_id, schedule.label("by_schedule"))
    joined = table.join(_JOBS, _JOBS.c.id == table.c.job_id)
    if subject == "drift":
        joined = joined.outerjoin(_RUNS, _RUNS.c.drift_id == table.c.id)
    return asked.select_from(joined)


def _asker(row: Any) -> Entry:  # noqa: ANN401 - a row
    if row.by_schedule is not None:
        return {"who": f"schedule {row.by_schedule}"}
    return {"who": row.asked_by, "key_id": row.key_id}


def _measured() -> Iterator[Entry]:
    """Those that succeeded; the standard deviations are in their results."""
    connection = op.get_bind()
    deviations: dict[str, Any] = dict.fromkeys(_DEVIATIONS, sa.Float())
    names = ("measurements", "scanner_id", "kind", "subject_id")
    measurements = _table(*names, number=sa.Integer(), at=_MOMENT, **deviations)
    columns = (measurements.c[name] for name in ("number", "scanner_id", "kind", "subject_id", "at"))
    every = connection.execute(sa.select(*columns).order_by(measurements.c.number)).all()
    for start in range(0, len(every), _BATCH):
        batch = every[start : start + _BATCH]
        asked: dict[tuple[str, str], Any] = {}
        for subject, table in _ASKED.items():
            ids = [row.subject_id for row in batch if row.kind == subject]
            asked |= {(subject, row.id): row for row in connection.execute(_asked(subject).where(table.c.id.in_(ids)))}
        for row in batch:
            of = asked[row.kind, row.subject_id]
            known = measurements.update().where(measurements.c.number == row.number)
            connection.execute(known.values(_deviations(row.kind, of.result)))
            entry = _entry(row.scanner_id, row.at, _KINDS[row.kind], "succeeded", row.kind, row.subject_id)
            yield entry | _asker(of) | {"why": _why(row.kind, of.result), "measurement_number": row.number}


def _deviations(subject: str, result: Entry) -> Entry:
    deviation = result.get("standard_deviation") or {}
    if subject == "calibration":
        deviation = deviation.get("source_frame") or {}
    tilt_rad = deviation.get("tilt_rad")
    tilt_deg = None if tilt_rad is None else math.degrees(tilt_rad)
    known = (deviation.get("cor_column_mm"), tilt_deg, deviation.get("source_to_detector_mm"))
    return dict(zip(_DEVIATIONS, known, strict=True))


def _why(subject: str, result: Entry) -> str | None:
    if subject == "drift":
        return str(result["reason"])
    compared = [(result.get("comparison") or {}).get("reason")]
    return "; ".join(each for each in (*result.get("reasons", ()), *compared) if each) or None


def _without_result() -> Iterator[Entry]:
    """Calibrations and drift checks that failed or were cancelled."""
    for subject, kind in _KINDS.items():
        ended = _asked(subject).add_columns(_JOBS.c.state, _JOBS.c.created_at, _JOBS.c.finished_at, _JOBS.c.failure)
        for row in op.get_bind().execute(ended.where(_JOBS.c.state.in_(("failed", "cancelled")))):
            at = row.finished_at or row.created_at
            entry = _entry(row.scanner_id, at, kind, row.state, subject, row.id)
            why = {"why": (row.failure or {}).get("detail")} if row.state == "failed" else _canceller(row.job_id)
            yield entry | _asker(row) | why


def _canceller(job_id: str) -> Entry:
    whose = (_AUDIT.c.subject_id == job_id, _AUDIT.c.action == "job-cancelled")
    entries = sa.select(_AUDIT.c.who, _AUDIT.c.key_id).where(*whose).order_by(_AUDIT.c.number.desc()).limit(1)
    row = op.get_bind().execute(entries).one_or_none()
    return {"who": row and row.who, "key_id": row and row.key_id}


def _activations() -> Iterator[Entry]:
    activations = _table(
        *("activations", "scanner_id", "calibration_id", "reason"), number=sa.Integer(), activated_at=_MOMENT
    )
    its_entry = sa.and_(
        _AUDIT.c.subject_id == activations.c.calibration_id,
        _AUDIT.c.at == activations.c.activated_at,
        _AUDIT.c.action.in_(("calibration-activated", "calibration-rolled-back")),
    )
    rows = sa.select(activations, _AUDIT.c.who, _AUDIT.c.key_id).select_from(activations.outerjoin(_AUDIT, its_entry))
    seen = set()
    for row in op.get_bind().execute(rows.order_by(activations.c.number)):
        again = (row.scanner_id, row.calibration_id) in seen
        seen.add((row.scanner_id, row.calibration_id))
        what = "calibration-rolled-back" if again else "calibration-activated"
        entry = _entry(row.scanner_id, row.activated_at, "activation", what, "calibration", row.calibration_id)
        yield entry | {"who": row.who, "key_id": row.key_id, "why": row.reason}


def _events() -> Iterator[Entry]:
    """Of scanners that there are still; whoever did it is in the audit where it was a person."""
    names = ("events", "what", "scanner_id", "subject", "subject_id")
    events = _table(*names, number=sa.Integer(), at=_MOMENT, detail=sa.JSON())
    its_entry = sa.and_(
        _AUDIT.c.subject_id == events.c.subject_id, _AUDIT.c.at == events.c.at, _AUDIT.c.action == events.c.what
    )
    joined = events.join(_SCANNERS, _SCANNERS.c.id == events.c.scanner_id).outerjoin(_AUDIT, its_entry)
    rows = sa.select(events, _AUDIT.c.who, _AUDIT.c.key_id).select_from(joined)
    for row in op.get_bind().execute(rows.where(events.c.what.in_(_ABOUT)).order_by(events.c.number)):
        known = row.detail or {}
        entry = _entry(row.scanner_id, row.at, _ABOUT[row.what], row.what, row.subject, row.subject_id)
        alarm = known.get("what") if entry["kind"] == "alarm" else None
        who = {"who": row.who or "the service", "key_id": row.key_id}
        yield entry | who | {"why": known.get("reason"), "alarm": alarm}


def downgrade() -> None:
    op.drop_table("history")
    for name in _DEVIATIONS:
        op.drop_column("measurements", name)
