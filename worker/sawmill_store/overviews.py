"""Overviews of scanners: the newest results of all scanners, read at once for pages and metrics."""

from datetime import datetime
from typing import Any, NamedTuple

from sqlalchemy import ScalarSelect, Select, select
from sqlalchemy.orm import InstrumentedAttribute, aliased

from sawmill_contracts.scanners import StoredScanner
from sawmill_mill.decisions import Decisions
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.database.database import Database
from sawmill_platform.database.tables import EventRow, JobRow
from sawmill_store.activations import active_calibration, last_discarded
from sawmill_store.scanners import scanner_with
from sawmill_store.tables import ActivationRow, CalibrationRow, DriftRow, ScannerRow, ScanRow

_WITH_A_FATE = (JobState.SUCCEEDED, JobState.FAILED)


class Overview(NamedTuple):
    """Ids of the newest results and the newest scan of one scanner; None where there is none.

    `ended_id` is the newest calibration that succeeded or failed, `succeeded_id` the newest that succeeded, `drift_id`
    the newest drift check that succeeded or failed, `seen_id` the newest that decided whether the scanner has moved
    since the active calibration. `scan_id` is the newest scan. `calibrating` is true while the newest calibration has
    not ended. `ended_at` and `succeeded_at` are when the two calibrations ended.
    """

    scanner: StoredScanner
    ended_id: str | None
    succeeded_id: str | None
    drift_id: str | None
    seen_id: str | None
    scan_id: str | None
    calibrating: bool
    ended_at: datetime | None
    succeeded_at: datetime | None
    decisions: Decisions


class Overviews:
    """Store of overviews: every method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def read(self, *, scanner_id: str | None = None, limit: int = 200) -> list[Overview]:
        """Return the overviews of the newest scanners, or of one scanner."""
        discarded = last_discarded(EventRow.at, ScannerRow.id)
        with_result = discarded.join(CalibrationRow, CalibrationRow.id == EventRow.subject_id).where(
            CalibrationRow.result.is_not(None)
        )
        statement = select(
            ScannerRow,
            _active_calibration().label("active_id"),
            _newest(CalibrationRow.id, CalibrationRow, *_WITH_A_FATE).label("ended_id"),
            _newest(CalibrationRow.id, CalibrationRow, JobState.SUCCEEDED).label("succeeded_id"),
            _newest(DriftRow.id, DriftRow, *_WITH_A_FATE).label("drift_id"),
            _newest_that_saw().label("seen_id"),
            _of_scanner(select(ScanRow.id), ScanRow, ScanRow.created_at).label("scan_id"),
            _state_of_newest_calibration().label("state"),
            _newest(JobRow.finished_at, CalibrationRow, *_WITH_A_FATE).label("ended_at"),
            _newest(JobRow.finished_at, CalibrationRow, JobState.SUCCEEDED).label("succeeded_at"),
            _of_scanner(select(ActivationRow.activated_at), ActivationRow, ActivationRow.number).label("activated_at"),
            discarded.correlate(ScannerRow).scalar_subquery().label("discarded_at"),
            with_result.correlate(ScannerRow).scalar_subquery().label("result_discarded_at"),
        )
        newest_first = statement.order_by(ScannerRow.created_at.desc(), ScannerRow.id.desc()).limit(limit)
        if scanner_id is not None:
            newest_first = newest_first.where(ScannerRow.id == scanner_id)
        with self._database.read() as session:
            return [_read(*row) for row in session.execute(newest_first)]


def _active_calibration() -> ScalarSelect[Any]:
    return active_calibration(ScannerRow.id).correlate(ScannerRow).scalar_subquery()


def _newest_that_saw() -> ScalarSelect[Any]:
    """Select the newest check against the active calibration that decided; failed or uncertain ones are left out."""
    of_active = select(DriftRow.id).where(DriftRow.calibration_id == _active_calibration())
    saw = of_active.where(DriftRow.result["within_tolerance"].as_boolean().is_not(None))
    return _of_scanner(saw, DriftRow, DriftRow.created_at)


def _newest(
    column: InstrumentedAttribute[Any], table: type[CalibrationRow | DriftRow], *states: JobState
) -> ScalarSelect[Any]:
    in_state = select(column).join_from(table, JobRow, JobRow.id == table.job_id).where(JobRow.state.in_(states))
    return _of_scanner(in_state, table, table.created_at)


def _state_of_newest_calibration() -> ScalarSelect[Any]:
    newest = aliased(CalibrationRow)
    states = select(JobRow.state).join(newest, newest.job_id == JobRow.id)
    return _of_scanner(states, newest, newest.created_at)


def _of_scanner(statement: Select[Any], table: Any, order: Any) -> ScalarSelect[Any]:  # noqa: ANN401 - aliases too
    """Select the first column of the scanner's newest row, which an index by scanner and time finds."""
    mine = statement.where(table.scanner_id == ScannerRow.id)
    return mine.order_by(order.desc()).limit(1).correlate(ScannerRow).scalar_subquery()


def _read(
    row: ScannerRow,
    active_id: str | None,
    ended_id: str | None,
    succeeded_id: str | None,
    drift_id: str | None,
    seen_id: str | None,
    scan_id: str | None,
    state: JobState | None,
    ended_at: datetime | None,
    succeeded_at: datetime | None,
    *decided: datetime | None,
) -> Overview:
    calibrating, decisions = state is not None and not state.ended, Decisions(*decided)
    newest = ended_id, succeeded_id, drift_id, seen_id, scan_id
    return Overview(scanner_with(row, active_id), *newest, calibrating, ended_at, succeeded_at, decisions)
