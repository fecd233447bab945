"""The faults that are tried on each engine."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tests.faults import injections, schedulers, upgrade
from tests.faults.trial import Trial


@dataclass(frozen=True)
class Engine:
    """An engine: the workers' software, and the database."""

    name: str
    celery: bool
    postgres: bool


ENGINES = (
    Engine("embedded-sqlite", celery=False, postgres=False),
    Engine("embedded-postgresql", celery=False, postgres=True),
    Engine("celery-sqlite", celery=True, postgres=False),
    Engine("celery-postgresql", celery=True, postgres=True),
)


@dataclass(frozen=True)
class Fault:
    """A class of faults.

    Attributes
    ----------
    disturb : callable
        Makes the faults (`injections`).
    on : callable
        True if an engine can have the fault.
    jobs_a_fault : int
        Number of jobs for each fault, at least.
    before : callable or None
        Called with the data folder and the database's URL before the product starts for the first time.
    begin, finish : callable or None
        Called with the trial at the beginning and once the jobs have ended.
    """

    name: str
    disturb: Callable[[Trial], None]
    on: Callable[[Engine], bool] = lambda _: True
    jobs_a_fault: int = 3
    services: int = 1
    clocks: bool = False
    small_disk: bool = False
    before: Callable[[Path, str], None] | None = None
    begin: Callable[[Trial], None] | None = None
    finish: Callable[[Trial], None] | None = None


FAULTS = (
    Fault("kill", injections.kill, jobs_a_fault=2),
    Fault("stop", injections.stop, on=lambda engine: not engine.celery, jobs_a_fault=6),
    Fault("terminate", injections.terminate, on=lambda engine: engine.celery == engine.postgres, jobs_a_fault=8),
    Fault("redis", injections.redis_trouble, on=lambda engine: engine.celery, jobs_a_fault=4),
    Fault("postgresql", injections.postgres_trouble, on=lambda engine: engine.postgres, jobs_a_fault=4),
    Fault(
        "disk",
        injections.disk_full,
        on=lambda engine: not engine.celery and not engine.postgres,
        jobs_a_fault=6,
        small_disk=True,
    ),
    Fault("clock", injections.clock_steps, on=lambda engine: not engine.celery, jobs_a_fault=3, clocks=True),
    Fault(
        "schedulers",
        injections.kill_services,
        on=lambda engine: not engine.celery and engine.postgres,  # SQLite's folder has one service
        jobs_a_fault=6,
        services=3,
        begin=schedulers.begin,
        finish=schedulers.finish,
    ),
    Fault(
        "upgrade",
        injections.kill,
        on=lambda engine: not engine.celery,
        jobs_a_fault=6,
        before=upgrade.before,
        begin=upgrade.begin,
    ),
)
