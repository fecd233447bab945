"""Measurements of calibrations and drift checks, written as the job ends (migration 0009), and which checks count."""

import math
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import ColumnElement, Select, and_, column, exists, func, or_, select, true, values
from sqlalchemy.orm import Session

from sawmill_contracts.calibrations import CalibrationResult
from sawmill_contracts.drifts import DriftResult
from sawmill_contracts.measurements import Measurement, MeasurementKind, Movement
from sawmill_mill.scanner_state import DriftCheck, counts_for_chart
from sawmill_mill.two_questions import TwoQuestions
from sawmill_platform.contracts.base import Contract, Page
from sawmill_platform.database.database import StorePart
from sawmill_platform.database.paging import found, read_numbered_page
from sawmill_platform.database.tables import UtcDateTime
from sawmill_store.activations import active_since
from sawmill_store.mill_tables import Answered, CalibrationRow, DriftRow, MeasurementRow, ScannerRow, ScanRow

MOST_READ, PARTS = 2000, 500
_NEVER = datetime.max.replace(tzinfo=UTC)
_COLUMNS = [getattr(MeasurementRow, name) for name in Movement._fields]
_MOVEMENTS = select(*_COLUMNS).order_by(MeasurementRow.at, MeasurementRow.number)


class Measurements(StorePart):
    """Store of measurements."""

    def page(
        self, scanner_id: str, *, since: datetime | None = None, after: str | None = None, limit: int = 50
    ) -> Page[Measurement]:
        """Return a page of one scanner's measurements, newest first.

        Raises
        ------
        NotFound, Invalid
            There is no such scanner; `after` is not a cursor that an earlier page gave.
        """
        newer = true() if since is None else MeasurementRow.at >= since
        statement = select(MeasurementRow).where(MeasurementRow.scanner_id == scanner_id, newer)
        with self._database.read() as session:
            found(session, ScannerRow, "scanner", scanner_id)
            return read_numbered_page(
                session, statement, MeasurementRow.number, Measurement.of_row, after=after, limit=limit
            )

    def movements(self, since: datetime, until: datetime) -> Mapping[str, list[Movement]]:
        """Return the movements of all scanners for small charts, by scanner, selected as by `movements_of`."""
        recent, of_each = MeasurementRow.at >= since, MeasurementRow.scanner_id
        many = select(of_each).where(recent).group_by(of_each).having(func.count() > MOST_READ)
        by_scanner: dict[str, list[Movement]] = {}
        with self._database.read() as session:
            crowded = session.scalars(many).all()
            typical = (_typical(scanner_id, since, until) for scanner_id in crowded)
            for condition in (and_(recent, of_each.not_in(crowded)), *typical):
                for row in session.execute(_MOVEMENTS.where(condition)):
                    by_scanner.setdefault(row.scanner_id, []).append(Movement(*row))
        return by_scanner

    def movements_of(self, scanner_id: str, since: datetime, until: datetime) -> tuple[list[Movement], int]:
        """Return one scanner's movements since a time for a chart, oldest first, and the number of measurements.

        Only some of more than `MOST_READ` measurements are returned: in each of `PARTS` equal parts of the time up to
        `until` the newest, the one whose rays moved farthest, and the newest calibration.
        """
        of_scanner = and_(MeasurementRow.scanner_id == scanner_id, MeasurementRow.at >= since)
        with self._database.read() as session:
            total = session.scalar(select(func.count()).select_from(MeasurementRow).where(of_scanner)) or 0
            condition = of_scanner if total <= MOST_READ else _typical(scanner_id, since, until)
            return [Movement(*row) for row in session.execute(_MOVEMENTS.where(condition))], total


def _typical(scanner_id: str, since: datetime, until: datetime) -> ColumnElement[bool]:
    """Select the measurements that represent each part of the time; the last part has no end.

    Each measurement is found by the index of a scanner's times: with 100 000 rows that takes an eighth of the time that
    ranking all rows takes.
    """
    starts = [since + (until - since) * (part / PARTS) for part in range(PARTS)]
    of_part = column("since", UtcDateTime()), column("until", UtcDateTime())
    parts = values(*of_part, name="parts").data(list(zip(starts, [*starts[1:], _NEVER], strict=True))).cte()
    later = MeasurementRow.at.desc(), MeasurementRow.number.desc()

    def first(*order: ColumnElement[Any], **of: MeasurementKind) -> Select[tuple[int]]:
        """Select the first measurement of each part; the newer one of equals."""
        in_part = (
            MeasurementRow.scanner_id == scanner_id,
            MeasurementRow.at >= parts.c.since,
            MeasurementRow.at < parts.c.until,
        )
        number = select(MeasurementRow.number).where(*in_part).filter_by(**of).order_by(*order, *later).limit(1)
        return select(number.correlate(parts).scalar_subquery()).select_from(parts)

    farthest_first = func.coalesce(MeasurementRow.ray_change_mm, -1.0).desc()
    numbers = first(), first(farthest_first), first(kind=MeasurementKind.CALIBRATION)
    return or_(*(MeasurementRow.number.in_(each) for each in numbers))


def record_measurement(session: Session, subject: Answered, result: Contract, now: datetime) -> str | None:
    """Add the measurement of a calibration or a drift check with a result, and return the result in a sentence.

    The time of the end is written into a drift check's result, and with it the age of the baseline. Other kinds measure
    nothing of a scanner.
    """
    if isinstance(subject, CalibrationRow) and isinstance(result, CalibrationResult):
        compared = [] if result.comparison is None else [result.comparison.reason]
        sentences = [TwoQuestions.of(result, None).rays.sentence(), *result.reasons, *compared]
        row, why = _of_calibration(subject, result, now), "; ".join(each.rstrip(".") for each in sentences)
    elif isinstance(subject, DriftRow) and isinstance(result, DriftResult):
        if result.at is None:
            result = result.ended(now)
            subject.result = result.model_dump(mode="json")
        row, why = _of_drift(subject, result, now, counts_since(session, subject, result)), result.reason
    else:
        return None
    session.add(row)
    return why


def _of_calibration(row: CalibrationRow, result: CalibrationResult, now: datetime) -> MeasurementRow:
    frame, change, error = result.source_frame, result.comparison, result.predicted_ray_error_mm
    deviation = result.deviations.source_frame
    return MeasurementRow(
        scanner_id=row.scanner_id,
        at=now,
        kind=MeasurementKind.CALIBRATION,
        subject_id=row.id,
        against_id=change and change.calibration_id,
        ray_change_mm=change and change.ray_change_mm,
        ray_change_tolerance_mm=change and change.tolerance_mm,
        within_tolerance=change and change.within_tolerance,
        scale_change_percent=change and change.scale_change_percent,
        cor_column_mm=frame.cor_column_mm,
        cor_column_standard_deviation_mm=deviation.cor_column_mm,
        cor_column_change_mm=change and change.cor_column_change_mm,
        tilt_rad=frame.tilt_rad,
        tilt_standard_deviation_rad=deviation.tilt_rad,
        tilt_change_rad=None if change is None else math.radians(change.tilt_change_deg),
        source_to_detector_mm=frame.source_to_detector_mm,
        source_to_detector_standard_deviation_mm=deviation.source_to_detector_mm,
        source_distance_mm=frame.source_distance_mm,
        relative_residual=result.residual.relative,
        gain=result.gain,
        ray_error_rms_mm=error and error.rms,
        ray_error_upper_95_mm=error and error.upper_95,
        scale_uncertainty_percent=result.scale_uncertainty_percent,
        verdict=result.verdict,
        rays_verdict=result.rays_verdict,
    )


def _of_drift(row: DriftRow, result: DriftResult, now: datetime, activation_number: int | None) -> MeasurementRow:
    zero = result.baseline
    return MeasurementRow(
        scanner_id=row.scanner_id,
        at=now,
        kind=MeasurementKind.DRIFT,
        subject_id=row.id,
        against_id=row.calibration_id,
        ray_change_mm=result.ray_change_mm,
        ray_change_tolerance_mm=result.tolerance_mm,
        within_tolerance=result.within_tolerance,
        scale_change_percent=result.scale_change_percent,
        cor_column_mm=result.measured.cor_column_mm,
        cor_column_standard_deviation_mm=result.standard_deviation.cor_column_mm,
        cor_column_change_mm=result.change.cor_column_mm,
        tilt_rad=result.measured.tilt_rad,
        tilt_standard_deviation_rad=result.standard_deviation.tilt_rad,
        tilt_change_rad=result.change.tilt_rad,
        source_to_detector_mm=result.measured.source_to_detector_mm,
        source_to_detector_standard_deviation_mm=result.standard_deviation.source_to_detector_mm,
        relative_residual=result.relative_residual,
        covariance=result.detector_change.covariance,
        method=result.method,
        baseline_checks=zero and zero.checks,
        baseline_age_hours=zero and zero.age_hours,
        cor_column_baseline_change_mm=zero and zero.change.cor_column_mm,
        tilt_baseline_change_rad=zero and zero.change.tilt_rad,
        activation_number=activation_number,
        input_sha256=result.input_sha256,
        awaits_chart=None if activation_number is None else True,
    )


def counts_since(session: Session, check: DriftRow, result: DriftResult) -> int | None:
    """Return the number of the activation since which a drift check counts; None where it does not count.

    The scanner's row is locked, so that checks that end at once get their numbers in the order of their commits.
    """
    lock_scanner(session, check.scanner_id)
    active = active_since(session, check.scanner_id)
    scan = session.get(ScanRow, check.scan_id)
    if active is None or scan is None:
        return None
    calibration = session.get_one(CalibrationRow, active.calibration_id)
    phantom_scan = session.get(ScanRow, calibration.scan_id) or calibration
    same = exists().where(
        MeasurementRow.activation_number == active.number,
        MeasurementRow.method == result.method,
        MeasurementRow.input_sha256 == result.input_sha256,
    )
    finished = DriftCheck(
        calibration_id=check.calibration_id,
        active_id=calibration.id,
        log_came_at=scan.created_at,
        phantom_came_at=phantom_scan.created_at,
        rotation=result.rotation,
        active_rotation=None if calibration.result is None else calibration.result["rotation"],
        method=result.method,
        change=result.detector_change,
        is_counted=session.scalar(select(same)) is True,
    )
    return active.number if counts_for_chart(finished) else None


def lock_scanner(session: Session, scanner_id: str) -> None:
    """Keep other transactions from a scanner's charts until this one ends; scans of the scanner may still come."""
    session.execute(select(ScannerRow.id).where(ScannerRow.id == scanner_id).with_for_update(key_share=True))
