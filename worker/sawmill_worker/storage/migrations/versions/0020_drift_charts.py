"""Drift checks with their covariance, baselines, and a chart of each scanner and method."""

from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0020"
down_revision = "0019"
branch_labels = None
depends_on = None

_NUMBERS = (
    "cor_column_tilt_covariance_mm_deg",
    "baseline_age_hours",
    "cor_column_baseline_change_mm",
    "tilt_baseline_change_deg",
    "pooled_cor_column_mm",
    "pooled_cor_column_standard_deviation_mm",
    "pooled_tilt_deg",
    "pooled_tilt_standard_deviation_deg",
)
_COUNTS = ("baseline_looks", "activation_number", "pooled_looks")
_TEXTS = {"method": 20, "input_sha256": 64}
_INDEXES = {
    "ix_measurements_looks": (["activation_number", "method", "number"], "activation_number IS NOT NULL"),
    "ix_measurements_counted": (["activation_number", "method", "input_sha256"], "activation_number IS NOT NULL"),
    "ix_measurements_awaiting_chart": (["scanner_id", "number"], "awaits_chart IS NOT NULL"),
}


def upgrade() -> None:
    columns: tuple[sa.Column[Any], ...] = (
        *(sa.Column(name, sa.Float(precision=53), nullable=True) for name in _NUMBERS),
        *(sa.Column(name, sa.Integer(), nullable=True) for name in _COUNTS),
        *(sa.Column(name, sa.String(length=length), nullable=True) for name, length in _TEXTS.items()),
        sa.Column("awaits_chart", sa.Boolean(), nullable=True),
    )
    for column in columns:
        op.add_column("measurements", column)
    for name, (of, which) in _INDEXES.items():
        op.create_index(name, "measurements", of, sqlite_where=sa.text(which), postgresql_where=sa.text(which))
    op.create_table(
        "drift_charts",
        sa.Column("scanner_id", sa.String(length=64), nullable=False),
        sa.Column("method", sa.String(length=20), nullable=False),
        sa.Column("activation_number", sa.Integer(), nullable=False),
        sa.Column("state", sa.JSON(), nullable=False),
        sa.Column("looks", sa.Integer(), nullable=False),
        sa.Column("changed_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("baseline", sa.JSON(), nullable=True),
        sa.Column("finding", sa.JSON(), nullable=False),
        sa.Column("alarm", sa.JSON(), nullable=True),
        sa.ForeignKeyConstraint(["scanner_id"], ["scanners.id"], name="fk_drift_charts_scanner_id", ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("scanner_id", "method", name="pk_drift_charts"),
    )
    op.add_column("alarms", sa.Column("drift", sa.JSON(), nullable=True))


def downgrade() -> None:
    # The version before knows no such alarm, and could not read the others beside it.
    op.execute("DELETE FROM alarms WHERE what = 'drift'")
    op.drop_column("alarms", "drift")
    op.drop_table("drift_charts")
    for name in _INDEXES:
        op.drop_index(name, "measurements")
    for name in (*_NUMBERS, *_COUNTS, *_TEXTS, "awaits_chart"):
        op.drop_column("measurements", name)
