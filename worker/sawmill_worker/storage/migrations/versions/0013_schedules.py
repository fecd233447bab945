"""Schedules: a time zone, and drift checks beside recalibrations."""

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0011"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("schedules", sa.Column("time_zone", sa.String(length=64), nullable=False, server_default="UTC"))
    op.add_column("schedules", sa.Column("kind", sa.String(length=20), nullable=False, server_default="recalibrate"))
    op.add_column("schedules", sa.Column("drift_options", sa.JSON(), nullable=False, server_default="{}"))
    op.add_column("schedule_runs", sa.Column("drift_id", sa.String(length=64), nullable=True))


def downgrade() -> None:
    op.drop_column("schedule_runs", "drift_id")
    for column in ("drift_options", "kind", "time_zone"):
        op.drop_column("schedules", column)
