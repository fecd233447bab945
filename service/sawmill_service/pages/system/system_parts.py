"""Parts of the page of the system: disk, workers, clock, versions and limits."""

import platform
from datetime import datetime, timedelta
from functools import cache
from importlib.metadata import version
from typing import NamedTuple

from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.jobs.job_store import Jobs
from sawmill_platform.jobs.queue_limits import Waiting
from sawmill_platform.ledger.events import Events
from sawmill_platform.settings import StorageSettings
from sawmill_service.pages.frame.page_frame import PageFrame
from sawmill_service.pages.job_words import JobView, job_view
from sawmill_service.settings import ServiceSettings
from sawmill_store.scans.scans import Scans
from sawmill_vocabulary.version import VERSION

# A worker that has taken no job for this time is not known to be there.
SEEN = timedelta(minutes=10)
# Free space of more than this many times the reserve is plenty.
PLENTY = 10
# Share of the places in the queue from which the queue is nearly full.
NEARLY = 0.8
MOST_WORKERS = 200
CLOCK_EVENTS = 5
PACKAGES = ("fastapi", "SQLAlchemy", "numpy", "scipy", "numba", "h5py", "celery")
# Limits that a person meets: uploads, requests, streams. Locations and secrets are not shown on a page.
LIMITS = (
    "max_upload_bytes",
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
    """Disk of the data folder."""

    free_bytes: int
    size_bytes: int
    reserve_bytes: int
    scans_bytes: int

    @property
    def used_share(self) -> float:
        """Share of the disk that is used, by any program."""
        return 1.0 - self.free_bytes / self.size_bytes

    @property
    def tone(self) -> str:
        """Bad where the disk counts as full, watch where that is near."""
        if self.free_bytes < self.reserve_bytes:
            return "bad"
        return "good" if self.free_bytes > PLENTY * self.reserve_bytes else "watch"


class Queue(NamedTuple):
    """Number of waiting jobs, and how many are allowed."""

    waiting: Waiting
    most: int
    most_of_a_key: int

    @property
    def tone(self) -> str:
        """Bad where new jobs are refused, watch where that is near."""
        full = max(self.waiting.in_all / self.most, self.waiting.most_of_a_key / self.most_of_a_key)
        return "good" if full < NEARLY else "watch" if full < 1.0 else "bad"


class Worker(NamedTuple):
    """Worker with its jobs, or with the last time at which it began or ended one."""

    name: str
    jobs: list[JobView]
    seen_at: datetime | None


class Limit(NamedTuple):
    """Setting in force."""

    name: str
    value: str | float
    description: str


def disk_of(scans: Scans, settings: StorageSettings) -> Disk:
    """Read the present state of the disk, or raise an `OSError`."""
    room = scans.files.room()
    return Disk(room.free_bytes, room.size_bytes, settings.disk_reserve_bytes, scans.uploaded_bytes())


def workers_of(events: Events, jobs: Jobs, page: PageFrame, now: datetime) -> list[Worker]:
    """Return the workers that run something, then those that ran something lately."""
    busy: dict[str, list[JobView]] = {}
    for job in jobs.page(state=JobState.RUNNING, limit=MOST_WORKERS).items:
        busy.setdefault(job.worker or "?", []).append(job_view(job, page))
    lately = events.workers_since(now - SEEN)
    working = [Worker(name, running, lately.get(name)) for name, running in busy.items()]
    return working + [Worker(name, [], at) for name, at in lately.items() if name not in busy]


@cache
def versions() -> dict[str, str]:
    """Return the versions of this process and the packages in it."""
    ours = {"sawmill-calibration": VERSION, "Python": platform.python_version()}
    return ours | {name: version(name) for name in PACKAGES}


def limits_of(settings: ServiceSettings, stored: StorageSettings) -> list[Limit]:
    """Return the limits that a person meets, by the names of their settings."""
    return [
        Limit(f"SAWMILL_{name.upper()}", getattr(these, name), type(these).model_fields[name].description or "")
        for these, names in ((settings, LIMITS), (stored, STORED_LIMITS))
        for name in names
    ]
