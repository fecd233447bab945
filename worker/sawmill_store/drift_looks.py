"""Which drift checks count as looks of a scanner's chart, each scan once."""

from sqlalchemy import exists, select
from sqlalchemy.orm import Session

from sawmill_contracts.drifts import DriftResult
from sawmill_store.activations import active_since
from sawmill_store.tables import CalibrationRow, DriftRow, MeasurementRow, ScannerRow, ScanRow

# The largest square of the correlation between u_c and tilt: nearer to 1, rounding decides what the inverse is.
MOST_CORRELATED = 1.0 - 1e-9


def counts_since(session: Session, check: DriftRow, result: DriftResult) -> int | None:
    """The number of the activation that a drift check is a look since; None where it does not count.

    It counts if it compared with the active calibration a log that was scanned after that one's phantom and turned in
    the same sense, and if its scan has not been counted. The scanner's row is locked, so that of several checks that
    end at once each has its number, in the order in which they are committed.
    """
    lock_scanner(session, check.scanner_id)
    active = active_since(session, check.scanner_id)
    scan = session.get(ScanRow, check.scan_id)
    if active is None or scan is None or active.calibration_id != check.calibration_id:
        return None
    calibration = session.get_one(CalibrationRow, active.calibration_id)
    phantom_scan = session.get(ScanRow, calibration.scan_id) or calibration
    turned = None if calibration.result is None else calibration.result["rotation"]
    if scan.created_at <= phantom_scan.created_at or result.rotation != turned or not _is_certain(result):
        return None
    same = exists().where(
        MeasurementRow.activation_number == active.number,
        MeasurementRow.method == result.method,
        MeasurementRow.input_sha256 == result.input_sha256,
    )
    return None if session.scalar(select(same)) else active.number


def lock_scanner(session: Session, scanner_id: str) -> None:
    """Keep others from its charts until the transaction ends; scans of it may come meanwhile."""
    session.execute(select(ScannerRow.id).where(ScannerRow.id == scanner_id).with_for_update(key_share=True))


def _is_certain(result: DriftResult) -> bool:
    """Whether the covariance of (u_c, tilt) can be inverted, also when it was stored in degrees and read again."""
    (column, cross, _), (_, tilt, _), _ = result.covariance
    return result.method is not None and column > 0.0 and tilt > 0.0 and cross**2 < MOST_CORRELATED * column * tilt
