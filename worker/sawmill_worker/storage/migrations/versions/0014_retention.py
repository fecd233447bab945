"""Rules of retention; the bytes of what is stored, and indices by age and for what refers to what goes."""

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0017"
branch_labels = None
depends_on = None

_MEASURED = ("scans", "calibrations", "reconstructions")
_BY_AGE = {
    "ix_scans_logs_by_age": ("scans", "phantom_id IS NULL"),
    "ix_scans_phantoms_by_age": ("scans", "phantom_id IS NOT NULL"),
    "ix_calibrations_by_age": ("calibrations", None),
    "ix_reconstructions_by_age": ("reconstructions", None),
}
# Without these, each row that goes costs a walk through whatever may refer to it.
_REFERENCES = (
    *(("scans", "job_id"), ("phantoms", "job_id")),
    *((table, "calibration_id") for table in ("asked", "reconstructions", "drifts", "activations", "schedule_runs")),
)


def upgrade() -> None:
    op.create_table(
        "retention",
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("rules", sa.JSON(), nullable=False),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.Column("changed_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("changed_by", sa.String(length=200), nullable=False),
        sa.Column("removed", sa.JSON(), nullable=False),
        sa.PrimaryKeyConstraint("number", name="pk_retention"),
    )
    for table in _MEASURED:
        op.add_column(table, sa.Column("stored_bytes", sa.BigInteger(), nullable=True))
        where = sa.text("stored_bytes IS NULL")
        op.create_index(f"ix_{table}_not_measured", table, ["id"], sqlite_where=where, postgresql_where=where)
    for name, (table, which) in _BY_AGE.items():
        some = None if which is None else sa.text(which)
        columns = ["created_at", "id", "stored_bytes"]
        op.create_index(name, table, columns, sqlite_where=some, postgresql_where=some)
    of_phantoms = sa.text("phantom_id IS NOT NULL")
    op.drop_index("ix_scans_phantom_id", "scans")
    op.create_index(
        "ix_scans_phantom_id", "scans", ["phantom_id"], sqlite_where=of_phantoms, postgresql_where=of_phantoms
    )
    for table in ("asked", "drifts"):
        op.create_index(f"ix_{table}_created_at_id", table, ["created_at", "id"])
    for table, column in _REFERENCES:
        op.create_index(f"ix_{table}_{column}", table, [column])


def downgrade() -> None:
    for table, column in _REFERENCES:
        op.drop_index(f"ix_{table}_{column}", table)
    for table in ("asked", "drifts"):
        op.drop_index(f"ix_{table}_created_at_id", table)
    op.drop_index("ix_scans_phantom_id", "scans")
    op.create_index("ix_scans_phantom_id", "scans", ["phantom_id"])
    for name, (table, _) in _BY_AGE.items():
        op.drop_index(name, table)
    for table in _MEASURED:
        op.drop_index(f"ix_{table}_not_measured", table)
        op.drop_column(table, "stored_bytes")
    op.drop_table("retention")
