"""Schedules: a time zone, and drift checks beside recalibrations. Alarms of absence."""

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0011"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("schedules", sa.Column("time_zone", sa.String(length=64), nullable=False, server_default="UTC"))
    op.add_column("schedules", sa.Column("kind", sa.String(length=20), nullable=False, server_default="recalibrate"))
    every_row = sa.Column("drift_options", sa.JSON(), nullable=False, server_default='{"rows": null}')
    op.add_column("schedules", every_row)
    op.add_column("schedule_runs", sa.Column("drift_id", sa.String(length=64), nullable=True))
    op.create_table(
        "alarms",
        sa.Column("scanner_id", sa.String(length=64), nullable=False),
        sa.Column("what", sa.String(length=40), nullable=False),
        sa.Column("since", sa.DateTime(timezone=True), nullable=False),
        sa.Column("last_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("limit_hours", sa.Float(precision=53), nullable=True),
        sa.Column("phantom_id", sa.String(length=64), nullable=True),
        sa.Column("expired_on", sa.Date(), nullable=True),
        sa.ForeignKeyConstraint(["scanner_id"], ["scanners.id"], name="fk_alarms_scanner_id", ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("scanner_id", "what", name="pk_alarms"),
    )
    op.create_index(
        "ix_scans_of_phantoms",
        "scans",
        ["scanner_id", "created_at"],
        sqlite_where=sa.text("phantom_id IS NOT NULL"),
        postgresql_where=sa.text("phantom_id IS NOT NULL"),
    )


def downgrade() -> None:
    op.drop_index("ix_scans_of_phantoms", "scans")
    op.drop_table("alarms")
    op.drop_column("schedule_runs", "drift_id")
    for column in ("drift_options", "kind", "time_zone"):
        op.drop_column("schedules", column)
