"""Jobs that are answered from an earlier result: what a result depends on, and whose it is."""

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("jobs", sa.Column("origin", sa.String(length=64), nullable=True))
    op.add_column("jobs", sa.Column("answered_from", sa.String(length=64), nullable=True))
    op.add_column("jobs", sa.Column("fresh", sa.Boolean(), nullable=False, server_default=sa.false()))
    op.create_index("ix_jobs_origin", "jobs", ["origin"])


def downgrade() -> None:
    op.drop_index("ix_jobs_origin", "jobs")
    for column in ("fresh", "answered_from", "origin"):
        op.drop_column("jobs", column)
