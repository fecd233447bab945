"""First tables."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "jobs",
        sa.Column("kind", sa.String(length=20), nullable=False),
        sa.Column("state", sa.String(length=20), nullable=False),
        sa.Column("subject_id", sa.String(length=64), nullable=False),
        sa.Column("attempt", sa.Integer(), nullable=False),
        sa.Column("worker", sa.String(length=200), nullable=True),
        sa.Column("lease_expires_s", sa.Float(precision=53), nullable=True),
        sa.Column("cancel_requested", sa.Boolean(), nullable=False),
        sa.Column("progress", sa.JSON(), nullable=True),
        sa.Column("failure", sa.JSON(), nullable=True),
        sa.Column("started_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("finished_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_jobs"),
    )
    op.create_index("ix_jobs_state_created_at_id", "jobs", ["state", "created_at", "id"])
    op.create_index("ix_jobs_subject_id", "jobs", ["subject_id"])

    op.create_table(
        "scanners",
        sa.Column("spec", sa.JSON(), nullable=False),
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_scanners"),
    )
    op.create_table(
        "job_dependencies",
        sa.Column("job_id", sa.String(length=64), nullable=False),
        sa.Column("needs_job_id", sa.String(length=64), nullable=False),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name="fk_job_dependencies_job_id"),
        sa.ForeignKeyConstraint(["needs_job_id"], ["jobs.id"], name="fk_job_dependencies_needs_job_id"),
        sa.PrimaryKeyConstraint("job_id", "needs_job_id", name="pk_job_dependencies"),
    )
    op.create_index("ix_job_dependencies_needs_job_id", "job_dependencies", ["needs_job_id"])

    op.create_table(
        "phantoms",
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("built_in", sa.Boolean(), nullable=False),
        sa.Column("state", sa.String(length=20), nullable=False),
        sa.Column("reason", sa.String(), nullable=True),
        sa.Column("drawing", sa.JSON(), nullable=True),
        sa.Column("picture", sa.JSON(), nullable=True),
        sa.Column("job_id", sa.String(length=64), nullable=True),
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name="fk_phantoms_job_id"),
        sa.PrimaryKeyConstraint("id", name="pk_phantoms"),
    )
    op.create_table(
        "schedules",
        sa.Column("scanner_id", sa.String(length=64), nullable=False),
        sa.Column("cron", sa.String(length=100), nullable=False),
        sa.Column("enabled", sa.Boolean(), nullable=False),
        sa.Column("on_pass", sa.String(length=20), nullable=False),
        sa.Column("options", sa.JSON(), nullable=False),
        sa.Column("next_due_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["scanner_id"], ["scanners.id"], name="fk_schedules_scanner_id"),
        sa.PrimaryKeyConstraint("id", name="pk_schedules"),
    )
    op.create_index("ix_schedules_next_due_at", "schedules", ["next_due_at"])

    op.create_table(
        "calibrations",
        sa.Column("scanner_id", sa.String(length=64), nullable=False),
        sa.Column("scan_id", sa.String(length=64), nullable=False),
        sa.Column("phantom_id", sa.String(length=64), nullable=False),
        sa.Column("schedule_id", sa.String(length=64), nullable=True),
        sa.Column("options", sa.JSON(), nullable=False),
        sa.Column("activate", sa.Boolean(), nullable=False),
        sa.Column("result", sa.JSON(), nullable=True),
        sa.Column("job_id", sa.String(length=64), nullable=False),
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name="fk_calibrations_job_id"),
        sa.ForeignKeyConstraint(["phantom_id"], ["phantoms.id"], name="fk_calibrations_phantom_id"),
        sa.ForeignKeyConstraint(["scanner_id"], ["scanners.id"], name="fk_calibrations_scanner_id"),
        sa.PrimaryKeyConstraint("id", name="pk_calibrations"),
        sa.UniqueConstraint("job_id", name="uq_calibrations_job_id"),
    )
    op.create_index("ix_calibrations_phantom_id", "calibrations", ["phantom_id"])
    op.create_index("ix_calibrations_scan_id", "calibrations", ["scan_id"])
    op.create_index("ix_calibrations_scanner_id_created_at", "calibrations", ["scanner_id", "created_at"])

    op.create_table(
        "scans",
        sa.Column("scanner_id", sa.String(length=64), nullable=False),
        sa.Column("phantom_id", sa.String(length=64), nullable=True),
        sa.Column("spec", sa.JSON(), nullable=False),
        sa.Column("state", sa.String(length=20), nullable=False),
        sa.Column("reason", sa.String(), nullable=True),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("reading", sa.JSON(), nullable=True),
        sa.Column("job_id", sa.String(length=64), nullable=False),
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name="fk_scans_job_id"),
        sa.ForeignKeyConstraint(["phantom_id"], ["phantoms.id"], name="fk_scans_phantom_id"),
        sa.ForeignKeyConstraint(["scanner_id"], ["scanners.id"], name="fk_scans_scanner_id"),
        sa.PrimaryKeyConstraint("id", name="pk_scans"),
    )
    op.create_index("ix_scans_phantom_id", "scans", ["phantom_id"])
    op.create_index("ix_scans_scanner_id_created_at", "scans", ["scanner_id", "created_at"])

    op.create_table(
        "activations",
        sa.Column("number", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("scanner_id", sa.String(length=64), nullable=False),
        sa.Column("calibration_id", sa.String(length=64), nullable=False),
        sa.Column("activated_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("reason", sa.String(), nullable=False),
        sa.ForeignKeyConstraint(["calibration_id"], ["calibrations.id"], name="fk_activations_calibration_id"),
        sa.ForeignKeyConstraint(["scanner_id"], ["scanners.id"], name="fk_activations_scanner_id"),
        sa.PrimaryKeyConstraint("number", name="pk_activations"),
    )
    op.create_index("ix_activations_scanner_id", "activations", ["scanner_id"])

    op.create_table(
        "reconstructions",
        sa.Column("scanner_id", sa.String(length=64), nullable=False),
        sa.Column("scan_id", sa.String(length=64), nullable=False),
        sa.Column("calibration_id", sa.String(length=64), nullable=True),
        sa.Column("options", sa.JSON(), nullable=False),
        sa.Column("result", sa.JSON(), nullable=True),
        sa.Column("job_id", sa.String(length=64), nullable=False),
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["calibration_id"], ["calibrations.id"], name="fk_reconstructions_calibration_id"),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name="fk_reconstructions_job_id"),
        sa.ForeignKeyConstraint(["scanner_id"], ["scanners.id"], name="fk_reconstructions_scanner_id"),
        sa.PrimaryKeyConstraint("id", name="pk_reconstructions"),
        sa.UniqueConstraint("job_id", name="uq_reconstructions_job_id"),
    )
    op.create_index("ix_reconstructions_scan_id", "reconstructions", ["scan_id"])
    op.create_index("ix_reconstructions_scanner_id_created_at", "reconstructions", ["scanner_id", "created_at"])

    op.create_table(
        "schedule_runs",
        sa.Column("number", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("schedule_id", sa.String(length=64), nullable=False),
        sa.Column("due_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("outcome", sa.String(length=40), nullable=False),
        sa.Column("calibration_id", sa.String(length=64), nullable=True),
        sa.ForeignKeyConstraint(["calibration_id"], ["calibrations.id"], name="fk_schedule_runs_calibration_id"),
        sa.ForeignKeyConstraint(
            ["schedule_id"], ["schedules.id"], name="fk_schedule_runs_schedule_id", ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("number", name="pk_schedule_runs"),
        sa.UniqueConstraint("schedule_id", "due_at", name="uq_schedule_runs_schedule_id_due_at"),
    )
