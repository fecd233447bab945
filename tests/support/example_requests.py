"""The committed example requests, as a client sends them."""

from typing import Any

from sqlalchemy import select

from sawmill_contracts.alarms import AlarmKind
from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_store.activations import active_calibration_id
from sawmill_store.mill_tables import AlarmRow, DriftRow
from sawmill_store.store import Store


def add_what_is_decided(store: Store) -> None:
    """Add an open alarm, a red scanner and a cancelled calibration: a fresh data folder has nothing to decide about."""
    calibration = store.calibrations.accept(CalibrationRequest(scan_id="example"), identifier="example-spare")
    store.jobs.request_cancel(calibration.job_id)
    with store.database.write() as session:
        check = session.scalars(select(DriftRow).where(DriftRow.result.is_not(None))).first()
        check.result = check.result | {"within_tolerance": False}
        check.calibration_id, check.created_at = active_calibration_id(session, "example"), store.now()
        session.add(AlarmRow(scanner_id="example", kind=AlarmKind.NO_PHANTOM_SCAN, since=store.now()))


def with_file(example: dict[str, Any], content: bytes) -> dict[str, Any]:
    """What httpx is given for an example whose body is a file of this content."""
    return {"content": content, "headers": example["headers"] | {"Content-Type": example["media_type"]}}
