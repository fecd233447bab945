"""A store in which jobs find their subjects."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from small_scanner import calibration, constants, scanner, sinogram, spec, theta, turn  # noqa: F401 - fixtures

from sawmill_worker.contracts.calibrations import CalibrationAsk
from sawmill_worker.contracts.jobs import Job, JobKind
from sawmill_worker.jobs.attempt import Attempt
from sawmill_worker.storage.settings import StorageSettings
from sawmill_worker.storage.store import Store
from sawmill_worker.vocabulary import Progress


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    opened = Store.open(StorageSettings(data_folder=tmp_path / "data", database_url=None))
    yield opened
    opened.close()


@pytest.fixture
def attempt(store: Store, tmp_path: Path) -> Callable[..., Attempt]:
    """An attempt at the newest job of a kind, and what it reported."""

    def at(kind: JobKind, reported: list[Progress] | None = None) -> Attempt:
        (job,) = store.jobs.page(kind=kind, limit=1).items
        output = tmp_path / f"output-{job.id}"
        output.mkdir()
        report = [].append if reported is None else reported.append
        return Attempt(job=job, store=store, output=output, report=report, announce=[].append)

    return at


@pytest.fixture
def finish(store: Store) -> Callable[[Attempt, dict[str, Any]], Job]:
    """Commit what an attempt made."""

    def commit(attempt: Attempt, result: dict[str, Any]) -> Job:
        claim = store.jobs.claim("test")
        assert claim is not None
        output = store.files.make_attempt_folder(claim.job_id, claim.attempt)
        for path in attempt.output.iterdir():
            path.rename(output / path.name)
        store.jobs.succeed(claim, result, output)
        return store.jobs.get(claim.job_id)

    return commit


@pytest.fixture
def ask() -> type[CalibrationAsk]:
    return CalibrationAsk
