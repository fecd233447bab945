"""Facts that decide whether a drift check counts for its scanner's chart (`sawmill_mill.drift_checks`)."""

from sqlalchemy import exists, select
from sqlalchemy.orm import Session

from sawmill_contracts.drifts import DriftResult
from sawmill_mill.drift_checks import DriftCheck, counts_for_chart
from sawmill_store.activations import active_since
from sawmill_store.mill_tables import CalibrationRow, DriftRow, MeasurementRow, ScannerRow, ScanRow


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
