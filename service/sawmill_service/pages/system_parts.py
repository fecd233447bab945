"""What the page of the system shows of disk, workers, clock, versions and limits."""

import platform
from datetime import datetime, timedelta
from functools import cache
from importlib.metadata import version
from typing import NamedTuple

from sawmill_platform.contracts.events import Event
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.jobs.queue_limits import Waiting
from sawmill_platform.settings import StorageSettings
from sawmill_service.pages.frame import PageFrame
from sawmill_service.pages.job_words import JobView, job_view
from sawmill_service.settings import ServiceSettings
from sawmill_store.store import Store
from sawmill_vocabulary.version import VERSION

# A worker that has taken no job for so long is not known to be there.
SEEN = timedelta(minutes=10)
# More than this many times the reserve is plenty.
PLENTY = 10
# Share of the places in the queue.
NEARLY = 0.8
# A disk that is full later than that needs nobody now.
PLENTY_DAYS = 30
MOST_WORKERS = 200
CLOCK_EVENTS = 5
PACKAGES = ("fastapi", "SQLAlchemy", "numpy", "scipy", "numba", "h5py", "celery")
# What a person runs into: uploads, requests, streams. Places and secrets are none of a page's.
LIMITS = (
    "max_upload_bytes",
    "max_form_bytes",
    "max_picture_bytes",
    "max_json_bytes",
    "max_connections",
    "max_requests_at_once",
    "max_bodies_at_once",
    "max_waits_at_once",
    "max_streams",
    "rate_limit",
    "change_rate_limit",
    "failed_login_rate_limit",
    "client_silence_s",
    "min_client_bytes_per_s",
)

STORED_LIMITS = ("max_queued_jobs", "max_queued_jobs_per_key")


class Disk(NamedTuple):
    """The data folder's disk."""

    free_bytes: int
    size_bytes: int
    reserve_bytes: int
    scans_bytes: int

    @property
    def used_share(self) -> float:
        """Of the disk, by whomever."""
        return 1.0 - self.free_bytes / self.size_bytes

    @property
    def tone(self) -> str:
        """Bad where it counts as full, a look where that is near."""
        if self.free_bytes < self.reserve_bytes:
            return "bad"
        return "good" if self.free_bytes > PLENTY * self.reserve_bytes else "watch"


class Queue(NamedTuple):
    """How many jobs wait, and how many may."""

    waiting: Waiting
    most: int
    most_of_a_key: int

    @property
    def tone(self) -> str:
        """Bad where somebody is refused, a look where that is near."""
        full = max(self.waiting.in_all / self.most, self.waiting.most_of_a_key / self.most_of_a_key)
        return "good" if full < NEARLY else "watch" if full < 1.0 else "bad"


class Worker(NamedTuple):
    """A worker that is known: with its job, or with the last time that it began or ended one."""

    name: str
    jobs: list[JobView]
    seen_at: datetime | None


class Limit(NamedTuple):
    """A setting in force."""

    name: str
    value: str | float
    description: str


def disk_of(store: Store) -> Disk:
    """As it is now, or an `OSError`."""
    room = store.files.room()
    reserve_bytes = store.settings.disk_reserve_bytes
    return Disk(room.free_bytes, room.size_bytes, reserve_bytes, store.scans.uploaded_bytes())


def queue_of(store: Store) -> Queue:
    """As it is now."""
    return Queue(store.places.waiting(), store.settings.max_queued_jobs, store.settings.max_queued_jobs_per_key)


def workers_of(store: Store, page: PageFrame, now: datetime) -> list[Worker]:
    """Those that run something first, then those that did lately."""
    busy: dict[str, list[JobView]] = {}
    for job in store.jobs.page(state=JobState.RUNNING, limit=MOST_WORKERS).items:
        busy.setdefault(job.worker or "?", []).append(job_view(job, page))
    lately = store.events.workers_since(now - SEEN)
    working = [Worker(name, jobs, lately.get(name)) for name, jobs in busy.items()]
    return working + [Worker(name, [], at) for name, at in lately.items() if name not in busy]


def clock_remarks(store: Store) -> list[Event]:
    """The newest first."""
    return store.events.of_clock()[::-1][:CLOCK_EVENTS]


@cache
def versions() -> dict[str, str]:
    """Of this process."""
    ours = {"sawmill-calibration": VERSION, "Python": platform.python_version()}
    return ours | {name: version(name) for name in PACKAGES}


def limits_of(settings: ServiceSettings, stored: StorageSettings) -> list[Limit]:
    """Those that a person runs into, each as its setting is called."""
    return [
        Limit(f"SAWMILL_{name.upper()}", getattr(these, name), type(these).model_fields[name].description or "")
        for these, names in ((settings, LIMITS), (stored, STORED_LIMITS))
        for name in names
    ]
