"""Charts of scanners' drift checks: each check that counts goes into its chart once, in the order of the ends.

The caller passes the function that computes a chart (`sawmill_calibration/drift_checks/baselines.py`). A chart has the
first drift checks since its activation, as many as its row says, and continues with the next checks. Checks that wait
for their chart are marked in their own rows. The chart is computed between two transactions: nobody waits for that.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, cast

from sqlalchemy import Select, select, update
from sqlalchemy.orm import Session

from sawmill_contracts.choices import DriftMethod
from sawmill_contracts.drifts import KnownBaseline
from sawmill_contracts.scanner_drift import POOLED_LOOKS, CountedLook, Follow, Followed, PooledDrift, ScannerDrift
from sawmill_platform.database.database import Database
from sawmill_platform.database.paging import found
from sawmill_store.activations import active_since
from sawmill_store.drift.measurements import lock_scanner
from sawmill_store.mill_tables import ActivationRow, DriftChartRow, MeasurementRow, ScannerRow
from sawmill_vocabulary import DetectorEstimate

# Drift checks in one transaction: less than 0.1 s of computing, and a hundredth of a second with the write lock.
PORTION = 100
_DAY_S = 86_400.0


@dataclass(frozen=True)
class _Portion:
    """The next drift checks of a chart."""

    scanner_id: str
    method: DriftMethod
    activation_number: int
    # (activation's number, number of looks) of the chart when the drift checks were read; None: there was no chart.
    chart: tuple[int, int] | None
    # state, charted: state of the chart, and the number of drift checks in the chart; empty: the chart has to be
    # started.
    state: dict[str, Any]
    charted: int
    # before, looks: newest checks in the chart, and the next checks, oldest first; none where the chart is of a later
    # activation.
    before: list[CountedLook]
    looks: list[CountedLook]
    numbers: list[int]  # numbers of the measurements in `looks`
    is_awaited: bool  # True if the newest of the checks waits; False while the chart is computed again from its start


class DriftCharts:
    """Store of drift charts: every method is one transaction; `follow` is one to read and one to write.

    Parameters
    ----------
    database
        Database of the rows.
    portion
        Number of drift checks that a transaction puts into a chart.
    """

    def __init__(self, database: Database, *, portion: int = PORTION) -> None:
        self._database = database
        self._portion = portion

    def waiting(self) -> list[str]:
        """Return the ids of the scanners that have drift checks waiting for a chart."""
        with self._database.read() as session:
            waiting = select(MeasurementRow.scanner_id).where(MeasurementRow.awaits_chart.is_not(None)).distinct()
            return sorted(session.scalars(waiting))

    def follow(self, scanner_id: str, follow: Follow) -> bool:
        """Put the next drift checks of a scanner into their chart, once each however many processes do so.

        A chart that `follow` cannot read is started again, from its first drift checks, at the next call.

        Returns
        -------
        bool
            True if there was a drift check to put in.
        """
        with self._database.read() as session:
            portion = _next_portion(session, scanner_id, self._portion)
        if portion is None:
            return False
        followed = follow(portion.state, portion.method, portion.before, portion.looks) if portion.looks else None
        with self._database.write() as session:
            lock_scanner(session, scanner_id)
            chart = session.get(DriftChartRow, (scanner_id, portion.method))
            # Otherwise another process has put these checks in since they were read.
            if _place(chart) == portion.chart:
                _write_portion(session, chart, portion, followed)
        return True

    def of_scanner(self, scanner_id: str) -> ScannerDrift:
        """Return the charts of a scanner since its active calibration, or raise `NotFound`."""
        with self._database.read() as session:
            found(session, ScannerRow, "scanner", scanner_id)
            active = active_since(session, scanner_id)
            if active is None:
                return ScannerDrift(charts=[])
            return ScannerDrift(charts=[read_chart(session, chart) for chart in _charts(session, active)])


def known_baselines(session: Session, scanner_id: str, calibration_id: str | None) -> tuple[KnownBaseline, ...]:
    """Return the baselines of a scanner's charts, one for each method; none where another calibration is active."""
    active = active_since(session, scanner_id)
    if active is None or active.calibration_id != calibration_id:
        return ()
    baselines = [chart.baseline for chart in _charts(session, active) if chart.baseline is not None]
    return tuple(KnownBaseline.model_validate(each) for each in baselines)


def _charts(session: Session, active: ActivationRow) -> Sequence[DriftChartRow]:
    of_activation = DriftChartRow.scanner_id == active.scanner_id, DriftChartRow.activation_number == active.number
    return session.scalars(select(DriftChartRow).where(*of_activation).order_by(DriftChartRow.method)).all()


def _next_portion(session: Session, scanner_id: str, most: int) -> _Portion | None:
    """Read the next portion of the chart for which the oldest drift check waits; None where no check waits."""
    waiting = MeasurementRow.scanner_id == scanner_id, MeasurementRow.awaits_chart.is_not(None)
    oldest = session.scalars(select(MeasurementRow).where(*waiting).order_by(MeasurementRow.number).limit(1)).first()
    if oldest is None or oldest.method is None or oldest.activation_number is None:
        return None
    activation = session.get_one(ActivationRow, oldest.activation_number)
    chart = session.get(DriftChartRow, (scanner_id, oldest.method))
    state, charted, rows = {}, 0, list[MeasurementRow]()
    if chart is not None and chart.activation_number == activation.number:
        state, charted = chart.state, chart.looks if chart.state else 0
    before = min(charted, POOLED_LOOKS)
    if chart is None or chart.activation_number <= activation.number:
        looks = _looks(activation.number, oldest.method).order_by(MeasurementRow.number)
        # The index alone is read: a hundred thousand rows are skipped in some milliseconds.
        numbers = looks.with_only_columns(MeasurementRow.number).offset(charted - before).limit(before + most)
        rows = list(session.scalars(looks.where(MeasurementRow.number.in_(numbers))))
    counted = [_counted(row, activation.activated_at) for row in rows]
    return _Portion(
        scanner_id,
        cast("DriftMethod", oldest.method),
        activation.number,
        _place(chart),
        state,
        charted,
        counted[:before],
        counted[before:],
        [row.number for row in rows[before:]],
        any(row.awaits_chart for row in rows[-1:]),
    )


def _place(chart: DriftChartRow | None) -> tuple[int, int] | None:
    return None if chart is None else (chart.activation_number, chart.looks)


def _looks(activation_number: int, method: str) -> Select[MeasurementRow]:
    """Select the drift checks by one method since an activation."""
    of_chart = MeasurementRow.activation_number == activation_number, MeasurementRow.method == method
    return select(MeasurementRow).where(*of_chart)


def _write_portion(session: Session, chart: DriftChartRow | None, portion: _Portion, followed: Followed | None) -> None:
    if chart is not None and chart.activation_number > portion.activation_number:
        late = MeasurementRow.activation_number == portion.activation_number, MeasurementRow.method == portion.method
        session.execute(update(MeasurementRow).where(*late).values(awaits_chart=None))
    elif followed is None:
        waiting = _looks(portion.activation_number, portion.method).where(MeasurementRow.awaits_chart.is_not(None))
        # In PostgreSQL each statement sees its own moment: a portion without checks may already be in the chart.
        if chart is not None and (portion.looks or session.scalar(select(waiting.exists()))):
            chart.state, chart.looks = {}, 0
    else:
        if chart is not None and chart.activation_number < portion.activation_number:
            session.delete(chart)
            session.flush()
            chart = None
        pools = zip(portion.numbers, followed.pools, strict=True)
        session.execute(update(MeasurementRow), [_pooled(number, *pool) for number, pool in pools])
        if chart is None:
            about = {"scanner_id": portion.scanner_id, "activation_number": portion.activation_number}
            chart = DriftChartRow(**about, method=portion.method)
            session.add(chart)
        # A chart that is computed again keeps its finding until waiting checks follow.
        chart.state = followed.state
        chart.looks = portion.charted + len(portion.looks)
        chart.changed_at = portion.looks[-1].at
        if portion.is_awaited:
            chart.finding = followed.finding.model_dump(mode="json")
        if followed.baseline is not None:
            chart.baseline = followed.baseline.model_dump(mode="json")
        if followed.alarm is not None and chart.alarm is None:
            finding, found_at = followed.alarm
            chart.alarm = {"at": found_at.isoformat(), "finding": finding.model_dump(mode="json")}


def _pooled(number: int, mean: DetectorEstimate, looks: int) -> dict[str, Any]:
    """Return the columns of a measurement that is in its chart, and so waits no longer."""
    (column, tilt), (column_deviation, tilt_deviation) = mean.values, mean.deviations
    return {
        "number": number,
        "awaits_chart": None,
        "pooled_checks": looks,
        "pooled_cor_column_mm": column,
        "pooled_cor_column_standard_deviation_mm": column_deviation,
        "pooled_tilt_rad": tilt,
        "pooled_tilt_standard_deviation_rad": tilt_deviation,
    }


def _counted(row: MeasurementRow, since: datetime) -> CountedLook:
    """Read a drift check that counts; its change and covariance are known."""
    change = DetectorEstimate.of((row.cor_column_change_mm or 0.0, row.tilt_change_rad or 0.0), row.covariance or [])
    return CountedLook(row.at, (row.at - since).total_seconds() / _DAY_S, row.calibrated, change)


def read_chart(session: Session, chart: DriftChartRow) -> PooledDrift:
    """Read the finding of a chart since its activation."""
    activation = session.get_one(ActivationRow, chart.activation_number)
    charted = _looks(chart.activation_number, chart.method).where(MeasurementRow.pooled_checks.is_not(None))
    newest = session.scalars(charted.order_by(MeasurementRow.number.desc()).limit(1)).one()
    pooled = {name: getattr(newest, name) for name in PooledDrift.model_fields if name.startswith("pooled_")}
    zero = None if chart.baseline is None else KnownBaseline.model_validate(chart.baseline)
    column, tilt = newest.calibrated
    return PooledDrift.model_validate(
        pooled
        | {
            "method": chart.method,
            "calibration_id": activation.calibration_id,
            "since": activation.activated_at,
            "checks": chart.looks,
            "last_at": chart.changed_at,
            "baseline": zero,
            "baseline_cor_column_mm": zero and column + zero.cor_column_offset_mm,
            "baseline_tilt_deg": zero and math.degrees(tilt + zero.tilt_offset_rad),
            "finding": chart.finding,
            "alarm": chart.alarm and chart.alarm["finding"],
        }
    )
