"""What calibrations and drift checks measured, a row each, filled from what is stored; the audit by its subject."""

import math
from collections.abc import Iterator
from datetime import datetime
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None

_NUMBERS = {
    "ray_change_mm": True,
    "ray_change_tolerance_mm": True,
    "scale_change_percent": True,
    "cor_column_mm": False,
    "cor_column_change_mm": True,
    "tilt_deg": False,
    "tilt_change_deg": True,
    "source_to_detector_mm": False,
    "source_distance_mm": True,
    "relative_residual": False,
    "gain": True,
    "ray_error_rms_mm": True,
    "ray_error_upper_95_mm": True,
    "scale_uncertainty_percent": True,
}
_MEASURED = (*_NUMBERS, "against_id", "within_tolerance", "verdict", "rays_verdict")
_BATCH = 200


def upgrade() -> None:
    measurements = op.create_table(
        "measurements",
        sa.Column("number", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("scanner_id", sa.String(length=64), nullable=False),
        sa.Column("at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("kind", sa.String(length=20), nullable=False),
        sa.Column("subject_id", sa.String(length=64), nullable=False),
        sa.Column("against_id", sa.String(length=64), nullable=True),
        sa.Column("within_tolerance", sa.Boolean(), nullable=True),
        sa.Column("verdict", sa.String(length=20), nullable=True),
        sa.Column("rays_verdict", sa.String(length=20), nullable=True),
        *(sa.Column(name, sa.Float(precision=53), nullable=nullable) for name, nullable in _NUMBERS.items()),
        sa.ForeignKeyConstraint(["scanner_id"], ["scanners.id"], name="fk_measurements_scanner_id"),
        sa.PrimaryKeyConstraint("number", name="pk_measurements"),
    )
    op.create_index("ix_measurements_at", "measurements", ["at"])
    op.create_index("ix_measurements_scanner_id_number", "measurements", ["scanner_id", "number"])
    op.create_index("ix_measurements_scanner_id_at", "measurements", ["scanner_id", "at"])
    op.create_index("ix_audit_subject_id_at", "audit", ["subject_id", "at"])
    for batch in _batches():
        op.bulk_insert(measurements, batch)


def _batches() -> Iterator[list[dict[str, Any]]]:
    """Of calibrations and drift checks that succeeded, in the order in which they ended, a few at a time."""
    connection, tables = op.get_bind(), _tables()
    ended = sa.union_all(*(_ended(kind, table) for kind, table in tables.items())).subquery()
    in_order = connection.execute(sa.select(ended).order_by(ended.c.at, ended.c.id)).all()
    for start in range(0, len(in_order), _BATCH):
        batch = in_order[start : start + _BATCH]
        found: dict[tuple[str, str], Any] = {}
        for kind, table in tables.items():
            chosen = sa.select(table).where(table.c.id.in_([row.id for row in batch if row.kind == kind]))
            found |= {(kind, row.id): row for row in connection.execute(chosen)}
        yield [_measured(row.kind, row.at, found[row.kind, row.id]) for row in batch]


def _tables() -> dict[str, sa.TableClause]:
    columns = {
        "calibrations": ("id", "scanner_id", "job_id"),
        "drifts": ("id", "scanner_id", "job_id", "calibration_id"),
    }
    calibrations, drifts = (
        sa.table(name, *(sa.column(one, sa.String()) for one in texts), sa.column("result", sa.JSON()))
        for name, texts in columns.items()
    )
    return {"calibration": calibrations, "drift": drifts}


def _ended(kind: str, table: sa.TableClause) -> sa.Select[Any]:
    """Its kind, its id, and when its job ended."""
    times = [sa.column(name, sa.DateTime(timezone=True)) for name in ("created_at", "finished_at")]
    jobs = sa.table("jobs", sa.column("id", sa.String()), sa.column("state", sa.String()), *times)
    at = sa.func.coalesce(jobs.c.finished_at, jobs.c.created_at).label("at")
    ended = sa.select(sa.literal(kind).label("kind"), table.c.id, at).join(jobs, jobs.c.id == table.c.job_id)
    return ended.where(jobs.c.state == "succeeded")


def _measured(kind: str, at: datetime, row: Any) -> dict[str, Any]:  # noqa: ANN401 - a row
    known = dict.fromkeys(_MEASURED) | {"scanner_id": row.scanner_id, "at": at, "kind": kind, "subject_id": row.id}
    if kind == "calibration":
        return known | _of_calibration(row.result)
    return known | {"against_id": row.calibration_id} | _of_drift(row.result)


def _of_calibration(result: dict[str, Any]) -> dict[str, Any]:
    """What an answer of any earlier version holds; the tolerance of its comparison does not stand in it."""
    frame, change = result["source_frame"], result.get("comparison") or {}
    error = result.get("predicted_ray_error_mm") or {}
    return {
        "against_id": change.get("calibration_id"),
        "ray_change_mm": change.get("ray_change_mm"),
        "within_tolerance": change.get("within_tolerance"),
        "scale_change_percent": change.get("scale_change_percent"),
        "cor_column_mm": frame["cor_column_mm"],
        "cor_column_change_mm": change.get("cor_column_change_mm"),
        "tilt_deg": math.degrees(frame["tilt_rad"]),
        "tilt_change_deg": change.get("tilt_change_deg"),
        "source_to_detector_mm": frame["source_to_detector_mm"],
        "source_distance_mm": frame["source_distance_mm"],
        "relative_residual": result["residual"]["relative"],
        "gain": result["gain"],
        "ray_error_rms_mm": error.get("rms"),
        "ray_error_upper_95_mm": error.get("upper_95"),
        "scale_uncertainty_percent": result.get("scale_uncertainty_percent"),
        "verdict": result["verdict"],
        "rays_verdict": result.get("rays_verdict"),
    }


def _of_drift(result: dict[str, Any]) -> dict[str, Any]:
    measured, change = result["measured"], result["change"]
    return {
        "ray_change_mm": result["ray_change_mm"],
        "ray_change_tolerance_mm": result["tolerance_mm"],
        "within_tolerance": result["within_tolerance"],
        "scale_change_percent": result.get("scale_change_percent"),
        "cor_column_mm": measured["cor_column_mm"],
        "cor_column_change_mm": change["cor_column_mm"],
        "tilt_deg": math.degrees(measured["tilt_rad"]),
        "tilt_change_deg": math.degrees(change["tilt_rad"]),
        "source_to_detector_mm": measured["source_to_detector_mm"],
        "relative_residual": result["relative_residual"],
    }


def downgrade() -> None:
    op.drop_index("ix_audit_subject_id_at", "audit")
    op.drop_table("measurements")
