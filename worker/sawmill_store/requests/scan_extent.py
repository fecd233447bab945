"""Whether a scan has the rows and views that are asked for, where its size is known already."""

from sqlalchemy.orm import Session

from sawmill_contracts.scans import ScanShape
from sawmill_platform.contracts.base import Contract, parse_rows
from sawmill_platform.errors import Invalid
from sawmill_store.tables import Answered, ScanRow

ROWS_ASKED_FOR = ("rows", "log_rows")


def refuse_beyond_scan(session: Session, row: Answered, ask: Contract) -> None:
    """Refuse rows and views that the scan does not have. One that is still read has no size: its job looks again.

    Raises
    ------
    Invalid
        The scan has fewer.
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
