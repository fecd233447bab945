"""References of a request: looked up as it is accepted, and kept from being deleted (`contracts.kinds.Reference`)."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from datetime import datetime
from types import MappingProxyType
from typing import Any

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from sawmill_contracts import fixed_pairs, inspections
from sawmill_contracts.declared_kinds import asked_kinds
from sawmill_contracts.kinds import Answer, AskedKind, Reference
from sawmill_contracts.phantoms import PhantomState
from sawmill_contracts.scans import ScanState
from sawmill_platform.contracts.jobs import UNFINISHED, JobState
from sawmill_platform.database.paging import found, hold
from sawmill_platform.database.tables import JobRow, Json
from sawmill_platform.errors import Conflict, NotFound
from sawmill_store.activations import active_calibration_id
from sawmill_store.mill_tables import Answered, AskedRow, CalibrationRow, PhantomRow, ScannerRow, ScanRow, table_of


def looked_up(
    session: Session, references: Iterable[Reference], request: Mapping[str, Any], now: datetime
) -> tuple[Json, list[str]]:
    """Look up the references of a request, and the jobs for which its own job waits."""
    fields, needs = dict(request), list[str]()
    for reference in references:
        if reference is Reference.INSPECTION:
            needs += _inspections(session, fields["inspection_ids"], now)
        elif (job_id := _LOOK_UP[reference](session, fields)) is not None:
            needs.append(job_id)
    return fields, needs


def _inspections(session: Session, inspection_ids: Iterable[str], now: datetime) -> Iterator[str]:
    """Yield the jobs of inspections, also of ended ones: files of inspections stay while a job needs their jobs."""
    for inspection_id in dict.fromkeys(inspection_ids):
        row = found_asked(session, inspections.DECLARATION, inspection_id)
        hold(session, AskedRow, "inspection", inspection_id)
        if row.created_at <= now - inspections.FILE_KEPT:
            raise inspections_file_gone(inspection_id)
        yield row.job_id


def inspections_file_gone(inspection_id: str) -> Conflict:
    """Return the refusal of an inspection whose file has been removed."""
    return Conflict(
        "inspection-expired",
        f"the file of inspection {inspection_id!r} has been removed, a day after it came: send it again",
    )


def _scan(session: Session, fields: Json) -> str | None:
    """Look up the scan, and lock its row until the transaction ends, so that the scan cannot be deleted."""
    scan = found(session, ScanRow, "scan", fields["scan_id"], lock=True)
    if scan.state is ScanState.REFUSED:
        raise Conflict("scan-refused", f"scan {scan.id!r} was refused and cannot be used: {scan.reason}")
    fields["scanner_id"] = scan.scanner_id
    return scan.job_id if scan.state is ScanState.INGESTING else None


def _scanner(session: Session, fields: Json) -> None:
    found(session, ScannerRow, "scanner", fields["scanner_id"])


def _phantom(session: Session, fields: Json) -> str | None:
    phantom_id = fields["phantom_id"] or found(session, ScanRow, "scan", fields["scan_id"]).phantom_id
    if phantom_id is None:
        raise Conflict(
            "phantom-not-named", f"scan {fields['scan_id']!r} names no phantom: name the one it shows, as phantom_id"
        )
    phantom = found(session, PhantomRow, "phantom", phantom_id, lock=True)
    check_usable(phantom)
    fields["phantom_id"] = phantom_id
    return phantom.job_id if phantom.state is PhantomState.TRACING else None


def check_usable(phantom: PhantomRow) -> None:
    """Raise `Conflict` for a phantom whose picture was refused."""
    if phantom.state is PhantomState.REFUSED:
        raise Conflict("phantom-refused", f"phantom {phantom.id!r} was refused and cannot be used: {phantom.reason}")


def _calibration(session: Session, fields: Json) -> str | None:
    """Look up the named calibration or the active one of the scan's scanner; the calibration may still be computed.

    Without one, an imported geometry is used; else a reconstruction waits for the first activation, which names its
    calibration.
    """
    if fields.get("theta") is not None:
        fields["calibration_id"] = None
        return None
    scan_id, scanner_id = fields["scan_id"], fields["scanner_id"]
    calibration_id = fields["calibration_id"] or active_calibration_id(session, scanner_id)
    if calibration_id is None and (imported := _imported(session, scanner_id)) is not None:
        fields |= imported
        return None
    if calibration_id is None and "theta" in fields and (job_id := _first_activation(session, scanner_id)) is not None:
        return job_id
    if calibration_id is None:
        instead = ", or give theta" if "theta" in fields else ""
        raise Conflict(
            "no-active-calibration",
            f"scanner {scanner_id!r} has no active calibration: name one as calibration_id{instead}",
        )
    calibration = found(session, CalibrationRow, "calibration", calibration_id)
    if calibration.scanner_id != scanner_id:
        msg = (
            f"calibration {calibration_id!r} is of scanner {calibration.scanner_id!r}, "
            f"but scan {scan_id!r} is of scanner {scanner_id!r}"
        )
        raise Conflict("scanner-mismatch", msg)
    state = calibration.job.state
    if state in _WITHOUT_RESULT:
        raise Conflict(
            "calibration-without-result",
            f"calibration {calibration_id!r} {_WITHOUT_RESULT[state]} and has no geometry to use",
        )
    hold(session, CalibrationRow, "calibration", calibration_id)
    fields["calibration_id"] = calibration_id
    return None if state.ended else calibration.job_id


def _imported(session: Session, scanner_id: str) -> Json | None:
    """Return the fields of a request with the scanner's imported geometry, if it has one."""
    spec = found(session, ScannerRow, "scanner", scanner_id).spec
    theta, turned = spec.get("imported_theta"), {"rotation": spec.get("rotation"), "handedness": spec.get("handedness")}
    return theta and {"theta": theta, "calibration_id": None, **turned}


def _first_activation(session: Session, scanner_id: str) -> str | None:
    """Return the job of the newest calibration under way that is to become a scanner's active one, if there is one."""
    asked = select(CalibrationRow.job_id).join(JobRow, CalibrationRow.job_id == JobRow.id)
    asked = asked.where(CalibrationRow.scanner_id == scanner_id, CalibrationRow.activate, JobRow.state.in_(UNFINISHED))
    return session.scalar(asked.order_by(CalibrationRow.created_at.desc()).limit(1))


_WITHOUT_RESULT = {JobState.FAILED: "failed", JobState.CANCELLED: "was cancelled"}


def _theta(session: Session, fields: Json) -> None:
    if fields["theta"] is not None:
        return
    scanner_id = fields["scanner_id"]
    calibration_id = active_calibration_id(session, scanner_id)
    if calibration_id is None and (imported := _imported(session, scanner_id)) is not None:
        fields["theta"] = imported["theta"]
        return
    if calibration_id is None:
        raise Conflict(
            "no-active-calibration",
            f"scanner {scanner_id!r} has no active calibration whose theta could be taken: give theta",
        )
    result = found(session, CalibrationRow, "calibration", calibration_id).result
    assert result is not None  # noqa: S101 - only a calibration with a result can be activated
    fields["theta"] = result["theta"]


def _fixed_pairs(session: Session, fields: Json) -> str | None:
    row = found_asked(session, fixed_pairs.DECLARATION, fields["fixed_pairs_id"])
    if (state := row.job.state) in _WITHOUT_RESULT:
        raise Conflict(
            "fixed-pairs-without-result", f"fixed-pairs {row.id!r} {_WITHOUT_RESULT[state]} and has no places to use"
        )
    return None if state.ended else row.job_id


_LOOK_UP: Mapping[Reference, Callable[[Session, Json], str | None]] = MappingProxyType(
    {
        Reference.SCAN: _scan,
        Reference.SCANNER: _scanner,
        Reference.PHANTOM: _phantom,
        Reference.CALIBRATION: _calibration,
        Reference.FIXED_PAIRS: _fixed_pairs,
        Reference.THETA: _theta,
    }
)


def found_asked(session: Session, declared: AskedKind[Any, Any], identifier: str) -> Answered:
    """Find the row with this id."""
    row = session.get(table_of(declared.kind), identifier)
    if row is None or row.job.kind is not declared.kind:
        raise NotFound(declared.noun, identifier)
    return row


def read_asked(declared: AskedKind[Any, Answer], row: Answered) -> Answer:
    """Read a row as the answer of the kind, with state and failure of the job."""
    columns = {column.key: getattr(row, column.key) for column in row.__table__.columns}
    return declared.read(columns | {name: getattr(row.job, name) for name in ("state", "failure")})


def kept_by(session: Session, reference: str, identifier: str) -> Iterator[tuple[str, int]]:
    """Yield plural and number of the rows that refer to an id, for each kind that blocks a deletion."""
    for declared in asked_kinds():
        table = table_of(declared.kind)
        if declared.blocks_deletion and reference in table.own_columns():
            referring = select(func.count()).select_from(table).join(JobRow, table.job_id == JobRow.id)
            referring = referring.where(JobRow.kind == declared.kind, getattr(table, reference) == identifier)
            yield declared.kind.plural, session.scalar(referring) or 0


def unfinished_job_about(session: Session, scan_id: str) -> str | None:
    """Return the id of a job that needs a scan and has not ended, if there is one."""
    column = "scan_id"
    for table in {table_of(declared.kind): None for declared in asked_kinds()}:
        if column in table.own_columns():
            job = select(JobRow.id).join(table, table.job_id == JobRow.id)
            job = job.where(getattr(table, column) == scan_id, JobRow.state.in_(UNFINISHED))
            busy = session.scalar(job.limit(1))
            if busy is not None:
                return busy
    return None
