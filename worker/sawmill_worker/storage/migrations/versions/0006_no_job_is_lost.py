"""Heartbeats are counted, jobs have a lane and a priority, what happened to each attempt is kept, and SQLite's time."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None

_BACKGROUND = 2
_INDICES = {
    "ix_jobs_created_at_id": ["created_at", "id"],
    "ix_jobs_queue": ["state", "priority", "created_at", "id"],
    "ix_jobs_lane": ["state", "short", "priority", "created_at", "id"],
    "ix_jobs_places": ["state", "priority", "short", "kind", "created_at", "id"],
}


def upgrade() -> None:
    op.add_column("jobs", sa.Column("beats", sa.Integer(), nullable=False, server_default="0"))
    op.add_column("jobs", sa.Column("short", sa.Boolean(), nullable=False, server_default=sa.false()))
    op.add_column("jobs", sa.Column("priority", sa.Integer(), nullable=False, server_default="0"))
    jobs = sa.table("jobs", sa.column("background", sa.Boolean()), sa.column("priority", sa.Integer()))
    op.execute(jobs.update().where(jobs.c.background).values(priority=_BACKGROUND))
    op.drop_column("jobs", "background")
    op.drop_column("jobs", "lease_expires_s")
    for name, columns in _INDICES.items():
        op.create_index(name, "jobs", columns)
    op.create_table(
        "events",
        sa.Column("number", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("what", sa.String(length=40), nullable=False),
        sa.Column("job_id", sa.String(length=64), nullable=True),
        sa.Column("attempt", sa.Integer(), nullable=True),
        sa.Column("worker", sa.String(length=200), nullable=True),
        sa.Column("detail", sa.JSON(), nullable=True),
        sa.PrimaryKeyConstraint("number", name="pk_events"),
    )
    op.create_index("ix_events_job_id", "events", ["job_id"])
    op.create_table(
        "clock",
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("boot", sa.String(length=64), nullable=False),
        sa.Column("offset_s", sa.Float(precision=53), nullable=False),
        sa.PrimaryKeyConstraint("number", name="pk_clock"),
    )


def downgrade() -> None:
    op.drop_table("clock")
    op.drop_table("events")
    for name in _INDICES:
        op.drop_index(name, "jobs")
    op.add_column("jobs", sa.Column("lease_expires_s", sa.Float(precision=53), nullable=True))
    op.add_column("jobs", sa.Column("background", sa.Boolean(), nullable=False, server_default=sa.false()))
    jobs = sa.table("jobs", sa.column("background", sa.Boolean()), sa.column("priority", sa.Integer()))
    op.execute(jobs.update().values(background=jobs.c.priority == _BACKGROUND))
    for column in ("priority", "short", "beats"):
        op.drop_column("jobs", column)
