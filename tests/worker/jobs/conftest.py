"""A store in which jobs find their subjects."""

import io
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from results import answer_of
from small_scanner import calibration, constants, scanner, sinogram, spec, theta, turn  # noqa: F401 - fixtures

from sawmill_contracts import kinds
from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import Scan, ScanSpec
from sawmill_platform.contracts.jobs import Job, JobKind
from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store
from sawmill_vocabulary import DataKind, Progress
from sawmill_worker.jobs.attempt import MillAttempt
from sawmill_worker.jobs.running import run


@pytest.fixture
def store(tmp_path: Path, empty_data: Path) -> Iterator[Store]:
    shutil.copytree(empty_data, tmp_path / "data")
    opened = Store(StorageSettings(data_folder=tmp_path / "data", database_url=None))
    yield opened
    opened.close()


@pytest.fixture
def attempt(store: Store, tmp_path: Path) -> Callable[..., MillAttempt]:
    """An attempt at the newest job of a kind, and what it reported."""

    def at(kind: JobKind, reported: list[Progress] | None = None) -> MillAttempt:
        (job,) = store.jobs.page(kind=kind, limit=1).items
        output = tmp_path / f"output-{job.id}"
        output.mkdir()
        report = [].append if reported is None else reported.append
        return MillAttempt(
            job=job, given=store.jobs.handed_over(job.id), output=output, report=report, announce=[].append
        )

    return at


@pytest.fixture
def finish(store: Store) -> Callable[[MillAttempt, dict[str, Any]], Job]:
    """Commit what an attempt made."""

    def commit(attempt: MillAttempt, result: dict[str, Any]) -> Job:
        claim = store.jobs.claim("test")
        assert claim is not None
        output = store.files.make_attempt_folder(claim.job_id, claim.attempt)
        for path in attempt.output.iterdir():
            path.rename(output / path.name)
        store.jobs.succeed(claim, answer_of(claim.job.kind, result), output)
        return store.jobs.get(claim.job_id)

    return commit


@pytest.fixture
def ask() -> type[CalibrationAsk]:
    return CalibrationAsk


@pytest.fixture
def upload(store: Store, spec: Callable[..., ScannerSpec]) -> Callable[[NDArray[np.float64], str], Scan]:  # noqa: F811
    """Accept a stack (views, rows, detector) of line integrals of one scanner's."""
    store.scanners.create(spec(), scanner_id="line-2")

    def accept(stack: NDArray[np.float64], angles_deg: str) -> Scan:
        buffer = io.BytesIO()
        np.save(buffer, stack.astype(np.float32))
        received = store.files.receive([buffer.getvalue()], max_bytes=10**8)
        reported = ScanSpec(
            scanner_id="line-2", data=DataKind.LINE_INTEGRALS, angles_deg=angles_deg, phantom_id="l-shape"
        )
        return store.scans.accept(reported, received)

    return accept


@pytest.fixture
def ingested(
    upload: Callable[[NDArray[np.float64], str], Scan],
    attempt: Callable[..., MillAttempt],
    finish: Callable[[MillAttempt, dict[str, Any]], Job],
) -> Callable[[NDArray[np.float64], str], Scan]:
    """The same, read and ready."""

    def ready(stack: NDArray[np.float64], angles_deg: str) -> Scan:
        scan = upload(stack, angles_deg)
        reading = attempt(kinds.INGEST)
        finish(reading, run(reading))
        return scan

    return ready


@pytest.fixture(autouse=True, scope="module")
def _in_one_thread(one_thread: None) -> None:
    """Their scans are small."""
