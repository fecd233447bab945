"""Overviews of scanners: the newest results of all scanners, read at once for pages and metrics."""

from datetime import UTC, datetime
from typing import Any, NamedTuple

from sqlalchemy import ColumnElement, RowMapping, ScalarSelect, Select, and_, func, or_, select, true
from sqlalchemy.orm import aliased

from sawmill_contracts.scanners import StoredScanner
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.database.database import StorePart
from sawmill_platform.database.tables import EventRow, JobRow
from sawmill_store.activations import active_calibration, discards
from sawmill_store.mill_tables import ActivationRow, CalibrationRow, DriftRow, MeasurementRow, ScannerRow, ScanRow
from sawmill_store.scanners.scanners import scanner_with

_NEVER = datetime.min.replace(tzinfo=UTC)
_WITH_A_FATE = (JobState.SUCCEEDED, JobState.FAILED)


class Overview(NamedTuple):
    """Ids of the newest results and the newest scan of one scanner; None where there is none.

    A calibration is undecided if it ended after the last acceptance and was not discarded. `ended_id` is the newest
    undecided one that succeeded or failed, `succeeded_id` the newest that succeeded, else the active one, `red_id` the
    newest whose rays fail or have moved since the active calibration. `drift_id` is the newest drift check that
    succeeded or failed, `seen_id` the newest that decided whether the scanner has moved since the active calibration.
    `scan_id` is the newest scan. `calibrating` is true while the newest calibration has not ended. `discarded_at` is
    when a calibration was last discarded since the last acceptance.
    """

    scanner: StoredScanner
    ended_id: str | None
    succeeded_id: str | None
    red_id: str | None
    drift_id: str | None
    seen_id: str | None
    scan_id: str | None
    calibrating: bool
    discarded_at: datetime | None


class Overviews(StorePart):
    """Store of overviews."""

    def read(self, *, scanner_id: str | None = None, limit: int = 200) -> list[Overview]:
        """Return the overviews of the newest scanners, or of one scanner."""
        since = discards(func.max(EventRow.at), ScannerRow.id).where(EventRow.at >= _accepted_at())
        ended = select(DriftRow.id).join(JobRow, JobRow.id == DriftRow.job_id).where(JobRow.state.in_(_WITH_A_FATE))
        # Failed or uncertain checks are left out.
        of_active = select(DriftRow.id).where(DriftRow.calibration_id == _active_calibration())
        saw = of_active.where(DriftRow.result["within_tolerance"].as_boolean().is_not(None))
        newest = aliased(CalibrationRow)
        selected = select(
            ScannerRow,
            _active_calibration().label("active_id"),
            _undecided(*_WITH_A_FATE).label("ended_id"),
            func.coalesce(_undecided(JobState.SUCCEEDED), _active_calibration()).label("succeeded_id"),
            _undecided(JobState.SUCCEEDED, only_red=True).label("red_id"),
            _of_scanner(ended, DriftRow, DriftRow.created_at).label("drift_id"),
            _of_scanner(saw, DriftRow, DriftRow.created_at).label("seen_id"),
            _of_scanner(select(ScanRow.id), ScanRow, ScanRow.created_at).label("scan_id"),
            _of_scanner(select(JobRow.state).join(newest, newest.job_id == JobRow.id), newest, newest.created_at).label(
                "state"
            ),
            since.correlate(ScannerRow).scalar_subquery().label("discarded_at"),
        ).where(true() if scanner_id is None else ScannerRow.id == scanner_id)
        newest_first = selected.order_by(ScannerRow.created_at.desc(), ScannerRow.id.desc()).limit(limit)
        with self._database.read() as session:
            return [_read(row) for row in session.execute(newest_first).mappings()]


def _active_calibration() -> ScalarSelect[Any]:
    return active_calibration(ScannerRow.id).correlate(ScannerRow).scalar_subquery()


def _accepted_at() -> ColumnElement[datetime]:
    """Select when the active calibration was accepted, or a time before all others."""
    return func.coalesce(_of_scanner(select(ActivationRow.activated_at), ActivationRow, ActivationRow.number), _NEVER)


def _undecided(*states: JobState, only_red: bool = False) -> ScalarSelect[Any]:
    """Select the newest calibration that ended since the last acceptance and was not discarded."""
    active = aliased(CalibrationRow)
    # Calibrations before the active one are left out first, by the index.
    requested = select(active.created_at).where(active.id == _active_calibration()).scalar_subquery()
    undecided = (
        select(CalibrationRow.id)
        .join(JobRow, JobRow.id == CalibrationRow.job_id)
        .where(
            CalibrationRow.created_at >= func.coalesce(requested, _NEVER),
            JobRow.state.in_(states),
            JobRow.finished_at >= _accepted_at(),
            CalibrationRow.id.not_in(discards(EventRow.subject_id, ScannerRow.id).correlate(ScannerRow)),
        )
    )
    if only_red:
        moved = and_(MeasurementRow.within_tolerance.is_(False), MeasurementRow.against_id == _active_calibration())
        fails = func.coalesce(MeasurementRow.rays_verdict, MeasurementRow.verdict) == "fail"
        measured = MeasurementRow.subject_id == CalibrationRow.id
        undecided = undecided.join(MeasurementRow, measured).where(or_(fails, moved))
    return _of_scanner(undecided, CalibrationRow, CalibrationRow.created_at)


def _of_scanner(statement: Select[Any], table: Any, order: Any) -> ScalarSelect[Any]:  # noqa: ANN401 - aliases too
    """Select the first column of the scanner's newest row, which an index by scanner and time finds."""
    mine = statement.where(table.scanner_id == ScannerRow.id)
    return mine.order_by(order.desc()).limit(1).correlate(ScannerRow).scalar_subquery()


def _read(row: RowMapping) -> Overview:
    found = {name: row[name] for name in Overview._fields if name in row}
    calibrating = row["state"] is not None and not row["state"].ended
    return Overview(scanner_with(row["ScannerRow"], row["active_id"]), calibrating=calibrating, **found)
