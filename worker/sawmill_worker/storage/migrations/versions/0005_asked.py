"""One table for every further kind of job that is asked for."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "asked",
        sa.Column("scanner_id", sa.String(length=64), nullable=True),
        sa.Column("scan_id", sa.String(length=64), nullable=True),
        sa.Column("phantom_id", sa.String(length=64), nullable=True),
        sa.Column("calibration_id", sa.String(length=64), nullable=True),
        sa.Column("options", sa.JSON(), nullable=False),
        sa.Column("result", sa.JSON(), nullable=True),
        sa.Column("job_id", sa.String(length=64), nullable=False),
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["calibration_id"], ["calibrations.id"], name="fk_asked_calibration_id"),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name="fk_asked_job_id"),
        sa.PrimaryKeyConstraint("id", name="pk_asked"),
        sa.UniqueConstraint("job_id", name="uq_asked_job_id"),
    )
    for column in ("scanner_id", "scan_id", "phantom_id"):
        op.create_index(f"ix_asked_{column}", "asked", [column])


def downgrade() -> None:
    op.drop_table("asked")
