"""Drift checks."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "drifts",
        sa.Column("scanner_id", sa.String(length=64), nullable=False),
        sa.Column("scan_id", sa.String(length=64), nullable=False),
        sa.Column("calibration_id", sa.String(length=64), nullable=False),
        sa.Column("options", sa.JSON(), nullable=False),
        sa.Column("result", sa.JSON(), nullable=True),
        sa.Column("job_id", sa.String(length=64), nullable=False),
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["calibration_id"], ["calibrations.id"], name="fk_drifts_calibration_id"),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name="fk_drifts_job_id"),
        sa.ForeignKeyConstraint(["scanner_id"], ["scanners.id"], name="fk_drifts_scanner_id"),
        sa.PrimaryKeyConstraint("id", name="pk_drifts"),
        sa.UniqueConstraint("job_id", name="uq_drifts_job_id"),
    )
    op.create_index("ix_drifts_scan_id", "drifts", ["scan_id"])
    op.create_index("ix_drifts_scanner_id_created_at", "drifts", ["scanner_id", "created_at"])
