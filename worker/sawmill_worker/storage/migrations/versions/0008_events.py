"""Events name the scanner that they concern and what they happened to."""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("events", sa.Column("scanner_id", sa.String(length=64), nullable=True))
    op.add_column("events", sa.Column("subject", sa.String(length=20), nullable=True))
    op.add_column("events", sa.Column("subject_id", sa.String(length=64), nullable=True))
    op.create_index("ix_events_scanner_id_number", "events", ["scanner_id", "number"])


def downgrade() -> None:
    op.drop_index("ix_events_scanner_id_number", "events")
    for column in ("subject_id", "subject", "scanner_id"):
        op.drop_column("events", column)
