"""Charts of scanners' drift checks: each check that counts goes into its chart once, in the order of their ends.

What a chart is, only the science knows (`use_cases/drift_following.py`): it is handed in. Checks that wait for their
chart are marked in their own rows, and the mark goes in the transaction that writes the chart.
"""

import math
from collections.abc import Sequence
from datetime import datetime
from itertools import groupby
from operator import attrgetter
from typing import cast

from sqlalchemy import Select, select
from sqlalchemy.orm import Session

from sawmill_worker.contracts.choices import DriftMethod
from sawmill_worker.contracts.drift_baselines import KnownBaseline
from sawmill_worker.contracts.scanner_drift import (
    CountedLook,
    Follow,
    Followed,
    Pool,
    PooledDrift,
    ScannerDrift,
)
from sawmill_worker.storage.database import Database
from sawmill_worker.storage.drift_looks import lock_scanner
from sawmill_worker.storage.paging import found
from sawmill_worker.storage.scanners import newest_activation
from sawmill_worker.storage.tables import ActivationRow, DriftChartRow, MeasurementRow, ScannerRow

# In a transaction: a second of work after an outage, and a moment of it as a rule.
MOST_AT_ONCE = 100
_DAY_S = 86_400.0


class DriftCharts:
    """Every method is one transaction, `follow` one for each batch."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def waiting(self) -> list[str]:
        """The scanners of which checks wait for their chart."""
        with self._database.read() as session:
            waiting = select(MeasurementRow.scanner_id).where(MeasurementRow.awaits_chart.is_not(None)).distinct()
            return sorted(session.scalars(waiting))

    def follow(self, scanner_id: str, follow: Follow) -> int:
        """Put a scanner's checks that wait into its charts, once each however many processes look; their number."""
        number = 0
        while True:
            with self._database.write() as session:
                # Of several processes, the second one finds what the first has left.
                lock_scanner(session, scanner_id)
                its = MeasurementRow.scanner_id == scanner_id, MeasurementRow.awaits_chart.is_not(None)
                oldest = select(MeasurementRow).where(*its).order_by(MeasurementRow.number).limit(MOST_AT_ONCE)
                rows = session.scalars(oldest).all()
                _chart_all(session, rows, follow)
            number += len(rows)
            if len(rows) < MOST_AT_ONCE:
                return number

    def of_scanner(self, scanner_id: str) -> ScannerDrift:
        """Its charts since the active calibration, or `NotFound`."""
        with self._database.read() as session:
            found(session, ScannerRow, "scanner", scanner_id)
            active = newest_activation(session, scanner_id)
            if active is None:
                return ScannerDrift(charts=[])
            charts = _charts(session, active)
            return ScannerDrift(charts=[_read(chart, active, _newest_look(session, chart)) for chart in charts])


def known_baselines(session: Session, scanner_id: str, calibration_id: str) -> tuple[KnownBaseline, ...]:
    """Of a scanner's charts since it has this calibration, one for each method; none where another one is active."""
    active = newest_activation(session, scanner_id)
    if active is None or active.calibration_id != calibration_id:
        return ()
    known = [chart.baseline for chart in _charts(session, active) if chart.baseline is not None]
    return tuple(KnownBaseline.model_validate(each) for each in known)


def _charts(session: Session, active: ActivationRow) -> Sequence[DriftChartRow]:
    its = DriftChartRow.scanner_id == active.scanner_id, DriftChartRow.activation_number == active.number
    return session.scalars(select(DriftChartRow).where(*its).order_by(DriftChartRow.method)).all()


def _chart_all(session: Session, rows: Sequence[MeasurementRow], follow: Follow) -> None:
    by_chart = attrgetter("activation_number", "method")
    for _, looks in groupby(sorted(rows, key=lambda row: (*by_chart(row), row.number)), by_chart):
        _chart(session, list(looks), follow)


def _chart(session: Session, rows: Sequence[MeasurementRow], follow: Follow) -> None:
    """Continue the chart that these looks belong to; those of an earlier activation than the chart's are left out."""
    for row in rows:
        row.awaits_chart = None
    newest = rows[-1]
    chart = session.get(DriftChartRow, (newest.scanner_id, newest.method))
    number = newest.activation_number
    if number is None or newest.method is None or (chart is not None and chart.activation_number > number):
        return
    if chart is not None and chart.activation_number < number:
        session.delete(chart)
        session.flush()
        chart = None
    since = session.get_one(ActivationRow, number).activated_at
    before = _charted(number, newest.method)

    def looks_before(most: int | None) -> list[CountedLook]:
        newest_first = session.scalars(before.order_by(MeasurementRow.number.desc()).limit(most))
        return [_counted(row, since) for row in newest_first][::-1]

    state = None if chart is None else chart.state
    method = cast("DriftMethod", newest.method)
    followed = follow(state, method, looks_before, [_counted(row, since) for row in rows])
    for row, pool in zip(rows, followed.pools, strict=True):
        _write_pool(row, pool)
    if chart is None:
        chart = DriftChartRow(scanner_id=newest.scanner_id, method=newest.method, activation_number=number, looks=0)
        session.add(chart)
    _write(chart, followed, len(rows), newest.at)


def _charted(activation_number: int, method: str) -> Select[MeasurementRow]:
    """Looks that their chart has."""
    of_chart = MeasurementRow.activation_number == activation_number, MeasurementRow.method == method
    return select(MeasurementRow).where(*of_chart, MeasurementRow.pooled_looks.is_not(None))


def _write(chart: DriftChartRow, followed: Followed, looks: int, at: datetime) -> None:
    chart.state = followed.state
    chart.looks += looks
    chart.changed_at = at
    chart.finding = followed.finding.model_dump(mode="json")
    if followed.baseline is not None:
        chart.baseline = followed.baseline.model_dump(mode="json")
    if followed.alarm is not None and chart.alarm is None:
        finding, found_at = followed.alarm
        chart.alarm = {"at": found_at.isoformat(), "finding": finding.model_dump(mode="json")}


def _write_pool(row: MeasurementRow, pool: Pool) -> None:
    row.pooled_looks = pool.looks
    row.pooled_cor_column_mm = pool.cor_column_mm
    row.pooled_cor_column_standard_deviation_mm = pool.cor_column_standard_deviation_mm
    row.pooled_tilt_deg = math.degrees(pool.tilt_rad)
    row.pooled_tilt_standard_deviation_deg = math.degrees(pool.tilt_standard_deviation_rad)


def _counted(row: MeasurementRow, since: datetime) -> CountedLook:
    """Of a drift check that counts: all of these are known of it."""
    column, tilt = row.cor_column_standard_deviation_mm or 0.0, math.radians(row.tilt_standard_deviation_deg or 0.0)
    cross = math.radians(row.cor_column_tilt_covariance_mm_deg or 0.0)
    return CountedLook(
        at=row.at,
        days=(row.at - since).total_seconds() / _DAY_S,
        cor_column_mm=row.cor_column_mm,
        tilt_rad=math.radians(row.tilt_deg),
        cor_column_change_mm=row.cor_column_change_mm or 0.0,
        tilt_change_rad=math.radians(row.tilt_change_deg or 0.0),
        covariance=((column**2, cross), (cross, tilt**2)),
    )


def _newest_look(session: Session, chart: DriftChartRow) -> MeasurementRow:
    charted = _charted(chart.activation_number, chart.method)
    return session.scalars(charted.order_by(MeasurementRow.number.desc()).limit(1)).one()


def _read(chart: DriftChartRow, active: ActivationRow, newest: MeasurementRow) -> PooledDrift:
    pooled = {name: getattr(newest, name) for name in PooledDrift.model_fields if name.startswith("pooled_")}
    zero = None if chart.baseline is None else KnownBaseline.model_validate(chart.baseline)
    calibrated_mm = newest.cor_column_mm - (newest.cor_column_change_mm or 0.0)
    calibrated_deg = newest.tilt_deg - (newest.tilt_change_deg or 0.0)
    return PooledDrift.model_validate(
        pooled
        | {
            "method": chart.method,
            "calibration_id": active.calibration_id,
            "since": active.activated_at,
            "looks": chart.looks,
            "last_at": chart.changed_at,
            "baseline": zero,
            "baseline_cor_column_mm": zero and calibrated_mm + zero.cor_column_offset_mm,
            "baseline_tilt_deg": zero and calibrated_deg + math.degrees(zero.tilt_offset_rad),
            "finding": chart.finding,
            "alarm": chart.alarm and chart.alarm["finding"],
        }
    )
