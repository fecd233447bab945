"""Check of requested rows and views against the size of a scan that has been read."""

from sqlalchemy.orm import Session

from sawmill_contracts.row_ranges import parse_rows
from sawmill_contracts.scans import ScanShape
from sawmill_platform.contracts.base import Contract
from sawmill_platform.errors import Invalid
from sawmill_store.tables import Answered, ScanRow

ROWS_ASKED_FOR = ("rows", "log_rows")


def refuse_beyond_scan(session: Session, row: Answered, ask: Contract) -> None:
    """Refuse rows and views that the scan does not have; the job checks a scan that has not been read yet.

    Raises
    ------
    Invalid
        The scan has fewer rows or views.
    """
    scan_id = getattr(row, "scan_id", None)
    scan = None if scan_id is None else session.get(ScanRow, scan_id)
    if scan is None or scan.reading is None:
        return
    shape = ScanShape.model_validate(scan.reading["shape"])
    for name in ROWS_ASKED_FOR:
        rows = getattr(ask, name, None)
        if rows is not None and parse_rows(rows).stop > shape.rows:
            raise Invalid("rows-outside", f"{name} is {rows}, but scan {scan.id!r} has rows 0:{shape.rows} only")
    views = getattr(ask, "views", None)
    if views is not None and views > shape.views:
        raise Invalid("views-too-many", f"views is {views}, but scan {scan.id!r} has {shape.views}")
