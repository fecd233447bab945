"""Tables of version 0.1.0. The numbers 0001 and 0002 belonged to states that no release had."""

import sqlalchemy as sa
from alembic import op

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
    unique,
)

revision = "0003"
down_revision = None
branch_labels = None
depends_on = None

_INDEXES = {
    "jobs": (["state", "created_at", "id"], ["subject_id"]),
    "job_dependencies": (["needs_job_id"],),
    "schedules": (["next_due_at"],),
    "calibrations": (["phantom_id"], ["scan_id"], ["scanner_id", "created_at"]),
    "scans": (["phantom_id"], ["scanner_id", "created_at"]),
    "activations": (["scanner_id"],),
    "reconstructions": (["scan_id"], ["scanner_id", "created_at"]),
    "drifts": (["scan_id"], ["scanner_id", "created_at"]),
}


def upgrade() -> None:
    op.create_table(
        "jobs",
        *needed(kind=WORD, state=WORD, subject_id=ID, attempt=INTEGER),
        *perhaps(worker=NAME, lease_expires_s=REAL),
        *needed(cancel_requested=FLAG),
        *perhaps(progress=JSON, failure=JSON, started_at=MOMENT, finished_at=MOMENT),
        *needed(id=ID, created_at=MOMENT),
        *keys("jobs", "id"),
    )
    op.create_table("scanners", *needed(spec=JSON, id=ID, created_at=MOMENT), *keys("scanners", "id"))
    op.create_table(
        "job_dependencies",
        *needed(job_id=ID, needs_job_id=ID),
        *keys("job_dependencies", "job_id", "needs_job_id", job_id="jobs", needs_job_id="jobs"),
    )
    op.create_table(
        "phantoms",
        *needed(name=NAME, built_in=FLAG, state=WORD),
        *perhaps(reason=TEXT, drawing=JSON, picture=JSON, job_id=ID),
        *needed(id=ID, created_at=MOMENT),
        *keys("phantoms", "id", job_id="jobs"),
    )
    op.create_table(
        "schedules",
        *needed(scanner_id=ID, cron=sa.String(length=100), enabled=FLAG, on_pass=WORD, options=JSON),
        *perhaps(next_due_at=MOMENT),
        *needed(id=ID, created_at=MOMENT),
        *keys("schedules", "id", scanner_id="scanners"),
    )
    op.create_table(
        "calibrations",
        *needed(scanner_id=ID, scan_id=ID, phantom_id=ID),
        *perhaps(schedule_id=ID),
        *needed(options=JSON, activate=FLAG),
        *perhaps(result=JSON),
        *needed(job_id=ID, id=ID, created_at=MOMENT),
        *keys("calibrations", "id", job_id="jobs", phantom_id="phantoms", scanner_id="scanners"),
        unique("calibrations", "job_id"),
    )
    op.create_table(
        "scans",
        *needed(scanner_id=ID),
        *perhaps(phantom_id=ID),
        *needed(spec=JSON, state=WORD),
        *perhaps(reason=TEXT),
        *needed(size_bytes=BYTES, sha256=ID),
        *perhaps(reading=JSON),
        *needed(job_id=ID, id=ID, created_at=MOMENT),
        *keys("scans", "id", job_id="jobs", phantom_id="phantoms", scanner_id="scanners"),
    )
    op.create_table(
        "activations",
        counted(),
        *needed(scanner_id=ID, calibration_id=ID, activated_at=MOMENT, reason=TEXT),
        *keys("activations", "number", calibration_id="calibrations", scanner_id="scanners"),
    )
    for table, of_calibration in (("reconstructions", perhaps), ("drifts", needed)):
        op.create_table(
            table,
            *needed(scanner_id=ID, scan_id=ID),
            *of_calibration(calibration_id=ID),
            *needed(options=JSON),
            *perhaps(result=JSON),
            *needed(job_id=ID, id=ID, created_at=MOMENT),
            *keys(table, "id", calibration_id="calibrations", job_id="jobs", scanner_id="scanners"),
            unique(table, "job_id"),
        )
    op.create_table(
        "plans",
        *needed(phantom_id=ID, scanner_id=ID, options=JSON),
        *perhaps(result=JSON),
        *needed(job_id=ID, id=ID, created_at=MOMENT),
        *keys("plans", "id", job_id="jobs"),
        unique("plans", "job_id"),
    )
    op.create_table(
        "schedule_runs",
        counted(),
        *needed(schedule_id=ID, due_at=MOMENT, outcome=EVENT),
        *perhaps(calibration_id=ID),
        *keys(
            "schedule_runs",
            "number",
            cascades=["schedule_id"],
            calibration_id="calibrations",
            schedule_id="schedules",
        ),
        unique("schedule_runs", "schedule_id", "due_at"),
    )
    for table, indexes in _INDEXES.items():
        for columns in indexes:
            op.create_index(f"ix_{table}_{'_'.join(columns)}", table, columns)
