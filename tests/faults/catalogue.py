"""The faults that are tried on each engine."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tests.faults import injections, upgrade
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
    """A class of faults, on the engines that can have it.

    `jobs_a_fault` is the least number of jobs for each fault. `before` is called with the data folder and the
    database's URL before the product starts for the first time, `begin` with the trial at the beginning.
    """

    name: str
    disturb: Callable[[Trial], None]
    on: Callable[[Engine], bool] = lambda _: True
    jobs_a_fault: int = 3
    before: Callable[[Path, str], None] | None = None
    begin: Callable[[Trial], None] | None = None


def _embedded(engine: Engine) -> bool:
    return not engine.celery


FAULTS = (
    Fault("kill", injections.kill, jobs_a_fault=2),
    Fault("stop", injections.stop, on=_embedded, jobs_a_fault=6),
    Fault("redis", injections.redis_trouble, on=lambda engine: engine.celery, jobs_a_fault=4),
    Fault("postgresql", injections.postgres_trouble, on=lambda engine: engine.postgres, jobs_a_fault=4),
    Fault("upgrade", injections.kill, on=_embedded, jobs_a_fault=6, before=upgrade.before, begin=upgrade.begin),
)
