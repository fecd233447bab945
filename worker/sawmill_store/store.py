"""Everything that a mill stores, behind one object."""

from typing import Self

from sqlalchemy import select
from sqlalchemy.orm import Session

from sawmill_contracts import calibrations, drifts, inspections, mill_events, plans, reconstructions
from sawmill_contracts.kinds import Answer, Ask, AskedKind
from sawmill_contracts.phantoms import BUILT_IN_PHANTOMS
from sawmill_contracts.plans import Plan, PlanRequest
from sawmill_platform.database.clock import Clock
from sawmill_platform.database.database import StorePart
from sawmill_platform.database.tables import EventRow
from sawmill_platform.job_service_store import JobServiceStore
from sawmill_platform.ledger.events import announce
from sawmill_platform.settings import StorageSettings
from sawmill_store.calibrations import Calibrations, Reconstructions
from sawmill_store.drift.drift_charts import DriftCharts
from sawmill_store.drift.measurements import Measurements
from sawmill_store.mill_files import MillFiles
from sawmill_store.requests.asked import Asked
from sawmill_store.retention.retention_store import RetentionStore
from sawmill_store.scanners.alarms import Alarms
from sawmill_store.scanners.history import Histories
from sawmill_store.scanners.overviews import Overviews
from sawmill_store.scanners.scanners import Scanners
from sawmill_store.scans.phantoms import Phantoms
from sawmill_store.scans.scans import Inspections, Scans
from sawmill_store.schedules.schedules import Schedules
from sawmill_store.subjects.mill_subjects import MILL_SUBJECTS


class MillZone(StorePart):
    """Store of the mill's time zone."""

    def get(self) -> str | None:
        """Return the name of the zone, such as Europe/Helsinki; None where nobody has set it."""
        with self._database.read() as session:
            return _newest(session)

    def set(self, time_zone: str, *, first: bool = False) -> None:
        """Set the zone; with `first` only where nobody has set one."""
        with self._database.write() as session:
            before = _newest(session)
            if before == time_zone or (first and before is not None):
                return
            detail = {"time_zone": time_zone}
            announce(
                session, self._database.now(), mill_events.TIME_ZONE_SET, "mill", "mill", detail=detail, decided=detail
            )


def _newest(session: Session) -> str | None:
    decisions = select(EventRow.detail).where(EventRow.type == mill_events.TIME_ZONE_SET)
    detail = session.scalar(decisions.order_by(EventRow.number.desc()).limit(1))
    return None if detail is None else str(detail["time_zone"])


Plans = Asked[PlanRequest, Plan]


class Store(JobServiceStore):
    """The resources of a mill, each with its own methods, and the resources of the job service."""

    files: MillFiles

    def __init__(self, settings: StorageSettings, *, clock: Clock | None = None) -> None:
        super().__init__(settings, MillFiles(settings.data_folder), MILL_SUBJECTS, clock)
        self.scanners = Scanners(self.database, settings.watch_folders)
        self.phantoms = Phantoms(self.database, self.files, self.places)
        self.scans = Scans(self.database, self.files, self.places)
        self.inspections = Inspections(self.database, self.files, self.places, inspections.DECLARATION)
        self.calibrations = Calibrations(self.database, self.files, self.places, calibrations.DECLARATION)
        self.reconstructions = Reconstructions(self.database, self.files, self.places, reconstructions.DECLARATION)
        self.plans = self.asked(plans.DECLARATION)
        self.drifts = self.asked(drifts.DECLARATION)
        self.measurements = Measurements(self.database)
        self.drift_charts = DriftCharts(self.database)
        self.history = Histories(self.database)
        self.schedules = Schedules(self.database, self.calibrations, self.drifts)
        self.alarms = Alarms(self.database)
        self.overviews = Overviews(self.database)  # newest results of every scanner
        self.mill_zone = MillZone(self.database)
        self.retention = RetentionStore(self.database)

    def asked(self, declared: AskedKind[Ask, Answer]) -> Asked[Ask, Answer]:
        """Return the store of the requests of one kind."""
        return Asked(self.database, self.files, self.places, declared)

    @classmethod
    def open(cls, settings: StorageSettings, *, clock: Clock | None = None, may_begin: bool = True) -> Self:
        """Open a store whose tables are up to date and which holds the built-in phantoms.

        Parameters
        ----------
        settings
            Data folder and database of the store.
        clock
            Clock for rows and due times; null: the clock that all processes on this store share.
        may_begin
            Option of `JobServiceStore.prepare`, which documents the errors.
        """
        store = cls(settings, clock=clock)
        store.prepare(may_begin=may_begin)
        return store

    def fill_new(self) -> None:
        """Write the phantoms that come with the software."""
        self.phantoms.seed_built_in(BUILT_IN_PHANTOMS)
