"""Queued jobs by the key that asked for them: how many of one key may wait is looked up for each that asks."""

import sqlalchemy as sa
from alembic import op

revision = "0018"
down_revision = "0013"
branch_labels = None
depends_on = None


def upgrade() -> None:
    queued = sa.text("state = 'queued'")
    op.create_index("ix_jobs_queued_of_key", "jobs", ["key_id"], sqlite_where=queued, postgresql_where=queued)


def downgrade() -> None:
    op.drop_index("ix_jobs_queued_of_key", "jobs")
