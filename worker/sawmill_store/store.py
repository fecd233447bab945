"""Everything that is stored, behind one object."""

from contextlib import AbstractContextManager
from datetime import datetime
from functools import partial

from sawmill_contracts import drifts, plans, reconstructions
from sawmill_contracts.built_in import BUILT_IN_PHANTOMS
from sawmill_platform.contracts.kinds import Answer, Ask, AskedKind
from sawmill_platform.database.clock import Clock
from sawmill_platform.database.database import Database
from sawmill_platform.database.engines import make_engine
from sawmill_platform.database.report import DatabaseReport, damage_of, report_of
from sawmill_platform.errors import FolderUnavailable
from sawmill_platform.files.file_store import FileStore, refuse_half_restored, refuse_read_only
from sawmill_platform.files.folder_identity import check_identity, settle_identity
from sawmill_platform.jobs.job_store import Jobs
from sawmill_platform.jobs.queue_limits import Places
from sawmill_platform.jobs.tallies import Tallies
from sawmill_platform.keys.key_store import KeyStore
from sawmill_platform.keys.repeats import Repeats
from sawmill_platform.keys.sessions import Sessions
from sawmill_platform.ledger.audit import Audit
from sawmill_platform.ledger.events import Events
from sawmill_platform.settings import StorageSettings
from sawmill_platform.uploads.upload_store import Uploads
from sawmill_platform.webhooks.outbox import Outbox
from sawmill_platform.webhooks.webhook_store import WebhookStore
from sawmill_store.alarms import Alarms
from sawmill_store.asked import Asked
from sawmill_store.backups.named_files import lost_files
from sawmill_store.calibrations import Calibrations
from sawmill_store.drift_charts import DriftCharts
from sawmill_store.history import Histories
from sawmill_store.inspections import Inspections
from sawmill_store.leftovers import Leftovers
from sawmill_store.measurements import Measurements
from sawmill_store.overviews import Overviews
from sawmill_store.phantoms import Phantoms
from sawmill_store.retention import RetentionStore
from sawmill_store.retention_runner import RetentionKeeper
from sawmill_store.scanners import Scanners
from sawmill_store.scans import Scans
from sawmill_store.schedules import Schedules


class Store:
    """The resources, each with its own methods; every method is one transaction and speaks in contracts.

    Attributes
    ----------
    scanners, phantoms, scans, inspections, uploads, calibrations, reconstructions, plans, drifts, measurements,
    history, jobs, schedules, alarms, events, keys, sessions, audit, repeats, retention, webhooks
        The rows.
    overviews
        Of every scanner at once.
    tallies
        Counts of them.
    places
        Those in the queue, which are bounded.
    files
        The arrays.
    settings
        With which another process can open the same store.
    """

    def __init__(self, settings: StorageSettings, *, clock: Clock | None = None) -> None:
        refuse_half_restored(settings.data_folder)
        self.settings = settings
        self.files = FileStore(settings.data_folder)
        self._database = Database(make_engine(settings.url, settings.database_password_file), clock)
        self.scanners = Scanners(self._database)
        self.places = Places(self._database, settings)
        self.phantoms = Phantoms(self._database, self.files, self.places)
        self.scans = Scans(self._database, self.files, self.places)
        self.inspections = Inspections(self._database, self.files, self.places)
        self.uploads = Uploads(self._database, self.files)
        self.calibrations = Calibrations(self._database, self.files, self.places)
        self.reconstructions = self.asked(reconstructions.DECLARATION)
        self.plans = self.asked(plans.DECLARATION)
        self.drifts = self.asked(drifts.DECLARATION)
        self.measurements = Measurements(self._database)
        self.drift_charts = DriftCharts(self._database)
        self.history = Histories(self._database)
        self.jobs = Jobs(self._database, self.files)
        self.tallies = Tallies(self._database)
        self.schedules = Schedules(self._database, self.calibrations, self.drifts)
        self.alarms = Alarms(self._database)
        self.events = Events(self._database)
        self.overviews = Overviews(self._database)
        self.keys = KeyStore(self._database)
        self.sessions = Sessions(self._database)
        self.audit = Audit(self._database)
        self.repeats = Repeats(self._database)
        self.webhooks = WebhookStore(self._database)
        self.retention = RetentionStore(self._database)

    def asked(self, declared: AskedKind[Ask, Answer]) -> Asked[Ask, Answer]:
        """The rows of any kind that is asked for."""
        return Asked(self._database, self.files, self.places, declared)

    def outbox(self) -> Outbox:
        """What is to be sent to webhooks, for one sender."""
        return Outbox(self._database)

    def leftovers(self, *, grace_s: float) -> Leftovers:
        """An observer of what no row knows, which removes it after a grace."""
        return Leftovers(self._database, self.files, grace_s=grace_s)

    def retention_keeper(self) -> RetentionKeeper:
        """Removes what the rules of retention reach."""
        return RetentionKeeper(self._database, self.files)

    @classmethod
    def open(cls, settings: StorageSettings, *, clock: Clock | None = None, may_begin: bool = True) -> "Store":
        """A store whose tables are up to date and which holds the built-in phantoms, in the folder of its database.

        Parameters
        ----------
        settings
            Where it is.
        clock
            The time for rows and due times; null: the one that all processes on this store share.
        may_begin
            Whether to set up a new database and an empty folder. A worker does not: its share may not be mounted yet.

        Raises
        ------
        FolderUnavailable
            The data folder is missing, empty, another one or read-only: nothing was made in it.
        StorageMisconfigured, StorageFull, StorageUnavailable
            The database cannot be used.
        """
        store = cls(settings, clock=clock)
        try:
            store._prepare_folder(may_begin=may_begin)
            store._database.upgrade(and_then=partial(settle_identity, folder=store.files.folder, may_begin=may_begin))
            store.files.make_folders()
            store._database.start_clock()
            store.phantoms.seed_built_in(BUILT_IN_PHANTOMS)
        except BaseException:
            store.close()
            raise
        return store

    def _prepare_folder(self, *, may_begin: bool) -> None:
        """Make the folder of a new database file, where that may begin here; refuse a folder on a read-only disk."""
        folder, file = self.files.folder, self.settings.database_file
        if not may_begin and ((file is not None and not file.is_file()) or self._database.is_new()):
            raise FolderUnavailable(
                f"the data folder {str(folder)!r} and its database have not been set up: mount the right folder, or "
                "start sawmill serve first"
            )
        if file is not None:
            folder.mkdir(parents=True, exist_ok=True)
        if folder.exists():
            refuse_read_only(folder)

    @property
    def time_has_an_owner(self) -> bool:
        """Whether the time is a row that one process owns, and not a database server's."""
        return self._database.engine.dialect.name == "sqlite"

    def now(self) -> datetime:
        """The time by which rows are stamped."""
        return self._database.now()

    def clock_off_s(self) -> float:
        """By how much this machine's clock is ahead of the store's."""
        return self._database.clock.off_s()

    def database_report(self) -> DatabaseReport:
        """Which database it is and how it answers, or `StorageUnavailable`."""
        return report_of(self._database)

    def damage(self) -> list[str]:
        """What the database finds wrong with its file, or `StorageUnavailable`."""
        return damage_of(self._database)

    def lost_files(self) -> list[str]:
        """Files that rows name and the data folder lacks, by their paths in it; `StorageUnavailable` or `OSError`."""
        return lost_files(self._database, self.files.folder)

    def check(self, *, reserve_bytes: int | None = None) -> None:
        """Check that rows and files can be written.

        Parameters
        ----------
        reserve_bytes
            Free bytes below which the disk counts as full; null: those of the settings.

        Raises
        ------
        StorageUnavailable
            The database does not answer, or the data folder is not in its place or cannot be written to.
        StorageFull
            The disk is full, or nearly so.
        """
        self.check_folder()
        self.files.check_writable()
        if reserve_bytes is None:
            self.files.check_room(self.settings.disk_reserve_bytes, needed_by="SAWMILL_DISK_RESERVE_BYTES")
        else:
            self.files.check_room(reserve_bytes, needed_by="writing a result")

    def fill_spare_room(self) -> None:
        """Keep room for cancellations free as long as the disk does not count as full; raise `OSError`."""
        self._database.spare_room.fill(self.settings.disk_reserve_bytes)

    def check_folder(self) -> None:
        """Check that the data folder is the one of the database.

        Raises
        ------
        StorageUnavailable
            The database does not answer, or (`FolderUnavailable`) the folder is missing, empty or another one.
        """
        with self._database.read() as session:
            check_identity(session, self.files.folder)

    def check_room_for(self, size_bytes: int) -> int:
        """Check that an upload of this size leaves the disk its reserve, and room for the uploads that were begun.

        Returns
        -------
        int
            The bytes that must stay free beside it.

        Raises
        ------
        StorageFull, StorageUnavailable
            Less would be free, the data folder is not in its place, or the database could not take what is made of it.
        """
        self._database.check_writable()
        self.check_folder()
        reserved_bytes = self.settings.disk_reserve_bytes + self.uploads.promised_bytes()
        needed_by = f"an upload of {size_bytes} bytes, beside others that were begun and SAWMILL_DISK_RESERVE_BYTES,"
        self.files.check_room(reserved_bytes + size_bytes, needed_by=needed_by)
        return reserved_bytes

    def as_one(self) -> AbstractContextManager[object]:
        """One transaction of all that this thread does with the store within the block."""
        return self._database.write_as_one()

    def close(self) -> None:
        """Let go of the database's connections."""
        self._database.engine.dispose()
