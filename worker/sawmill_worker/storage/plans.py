"""Plans: asked for, and computed by a job."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from sawmill_worker.contracts.base import Page
from sawmill_worker.contracts.jobs import JobKind
from sawmill_worker.contracts.phantoms import PhantomState
from sawmill_worker.contracts.plans import Plan, PlanAsk, PlanAsked
from sawmill_worker.storage.database import Database
from sawmill_worker.storage.errors import Conflict
from sawmill_worker.storage.paging import found, narrowed, new_id, read_page, refuse_taken
from sawmill_worker.storage.queueing import queue_job
from sawmill_worker.storage.scanners import active_calibration_id
from sawmill_worker.storage.tables import CalibrationRow, Json, PhantomRow, PlanRow, ScannerRow


class Plans:
    """Every method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def accept(self, phantom_id: str, ask: PlanAsk, *, plan_id: str | None = None, background: bool = False) -> Plan:
        """Queue a plan; while the phantom's picture is being traced, it waits for that.

        Without a theta, that of the scanner's active calibration is taken, as it is now.
        In the `background` it starts only when no other job could.

        Raises
        ------
        NotFound
            There is no such phantom or scanner.
        Conflict
            The phantom was refused, no theta was given and no calibration is active, or the id is taken.
        """
        identifier = plan_id or new_id()
        now = self._database.now()
        with self._database.write() as session:
            refuse_taken(session, PlanRow, "plan", identifier)
            phantom = found(session, PhantomRow, "phantom", phantom_id)
            if phantom.state is PhantomState.REFUSED:
                raise Conflict("phantom-refused", f"phantom {phantom_id!r} cannot be used: {phantom.reason}")
            found(session, ScannerRow, "scanner", ask.scanner_id)
            asked: PlanAsked = ask
            if asked.theta is None:
                asked = PlanAsked.model_validate(ask.model_dump() | {"theta": _active_theta(session, ask.scanner_id)})
            needs = [phantom.job_id] if phantom.state is PhantomState.TRACING and phantom.job_id else []
            row = PlanRow(
                id=identifier,
                created_at=now,
                phantom_id=phantom_id,
                scanner_id=ask.scanner_id,
                options=asked.model_dump(mode="json"),
                job_id=queue_job(session, JobKind.PLAN, identifier, now, needs=needs, background=background),
            )
            session.add(row)
            session.flush()
            session.refresh(row, ["job"])
            return _read(row)

    def get(self, plan_id: str) -> Plan:
        """One plan, or `NotFound`."""
        with self._database.read() as session:
            return _read(found(session, PlanRow, "plan", plan_id))

    def page(self, *, phantom_id: str | None = None, after: str | None = None, limit: int = 50) -> Page[Plan]:
        """Plans, newest first."""
        statement = narrowed(select(PlanRow), {PlanRow.phantom_id: phantom_id})
        with self._database.read() as session:
            return read_page(session, statement, PlanRow, _read, after=after, limit=limit)


def _active_theta(session: Session, scanner_id: str) -> Json:
    calibration_id = active_calibration_id(session, scanner_id)
    if calibration_id is None:
        msg = f"scanner {scanner_id!r} has no active calibration whose theta could be taken: give theta"
        raise Conflict("no-active-calibration", msg)
    result = found(session, CalibrationRow, "calibration", calibration_id).result
    assert result is not None  # noqa: S101 - only a calibration with a result can be activated
    theta: Json = result["theta"]
    return theta


def _read(row: PlanRow) -> Plan:
    return Plan.model_validate(
        {
            "id": row.id,
            "created_at": row.created_at,
            "state": row.job.state,
            "phantom_id": row.phantom_id,
            "scanner_id": row.scanner_id,
            "job_id": row.job_id,
            "options": row.options,
            "result": row.result,
            "failure": row.job.failure,
        }
    )
