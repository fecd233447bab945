"""A store in which jobs find their subjects."""

import io
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from results import succeed
from small_scanner import calibration, constants, scanner, sinogram, spec, theta, turn  # noqa: F401 - fixtures

from sawmill_contracts import kinds
from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.reconstructions import ReconstructionRequest
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
    def commit(attempt: MillAttempt, result: dict[str, Any]) -> Job:
        def move(output: Path) -> None:
            for path in attempt.output.iterdir():
                path.rename(output / path.name)

        return store.jobs.get(succeed(store, write=move, result=result).job_id)

    return commit


@pytest.fixture
def send(store: Store, spec: Callable[..., ScannerSpec]) -> Callable[..., Scan]:  # noqa: F811
    store.scanners.create(spec(), scanner_id="line-2")

    def accept(content: NDArray[Any] | dict[str, NDArray[Any]], **declared: Any) -> Scan:
        buffer = io.BytesIO()
        np.savez(buffer, **content) if isinstance(content, dict) else np.save(buffer, content.astype(np.float32))
        received = store.files.receive([buffer.getvalue()], max_bytes=10**8)
        return store.scans.accept(ScanSpec(scanner_id="line-2", **declared), received)

    return accept


@pytest.fixture
def upload(send: Callable[..., Scan]) -> Callable[[NDArray[np.float64], str], Scan]:
    return lambda stack, angles_deg: send(
        stack, data=DataKind.LINE_INTEGRALS, angles_deg=angles_deg, phantom_id="l-shape"
    )


@pytest.fixture
def ingest(attempt: Callable[..., MillAttempt], finish: Callable[[MillAttempt, dict[str, Any]], Job]) -> Callable:
    def read(scan: Scan) -> Scan:
        reading = attempt(kinds.INGEST)
        finish(reading, run(reading))
        return scan

    return read


@pytest.fixture
def ingested(
    upload: Callable[[NDArray[np.float64], str], Scan], ingest: Callable[[Scan], Scan]
) -> Callable[[NDArray[np.float64], str], Scan]:
    return lambda stack, angles_deg: ingest(upload(stack, angles_deg))


@pytest.fixture
def calibrating(store: Store, attempt: Callable[..., MillAttempt]) -> Callable[..., MillAttempt]:
    def ask(scan: Scan, reported: list[Progress] | None = None, **options: Any) -> MillAttempt:
        store.calibrations.accept(CalibrationRequest(scan_id=scan.id, **options))
        return attempt(kinds.CALIBRATE, reported)

    return ask


@pytest.fixture
def reconstructing(store: Store, attempt: Callable[..., MillAttempt]) -> Callable[..., MillAttempt]:
    def ask(scan: Scan, **options: Any) -> MillAttempt:
        store.reconstructions.accept(ReconstructionRequest(scan_id=scan.id, **options))
        return attempt(kinds.RECONSTRUCT)

    return ask
