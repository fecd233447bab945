"""Jobs that wait: losses counted apart from attempts, when to try again and why, and work for idle times."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("jobs", sa.Column("background", sa.Boolean(), nullable=False, server_default=sa.false()))
    op.add_column("jobs", sa.Column("losses", sa.Integer(), nullable=False, server_default="0"))
    op.add_column("jobs", sa.Column("outages", sa.Integer(), nullable=False, server_default="0"))
    op.add_column("jobs", sa.Column("not_before_s", sa.Float(precision=53), nullable=True))
    op.add_column("jobs", sa.Column("waiting_for", sa.JSON(), nullable=True))


def downgrade() -> None:
    for column in ("waiting_for", "not_before_s", "outages", "losses", "background"):
        op.drop_column("jobs", column)
