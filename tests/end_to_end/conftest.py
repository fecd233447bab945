"""Real servers, and the scans that they are sent."""

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_service import JOB_S, SCANNER, Offline, Service, process, serving
from tiers import first_by_day

from sawmill_calibration.simulation import write_simulated_scan
from sawmill_tomography.geometry.geometry import FanBeamGeometry, Scanner, Theta
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM, LogModel
from sawmill_tomography.projection.simulate import simulate_stack

THETA = Theta(0.7, 728.0, -254.0, -37.0, -0.21)
VIEWS, PHANTOM_ROWS, LOG_ROWS, ROW_PITCH_MM = 180, 2, 2, 3.0


@pytest.fixture(scope="session")
def offline(tmp_path_factory: pytest.TempPathFactory) -> Offline:
    return Offline(tmp_path_factory.mktemp("offline"))


@pytest.fixture(scope="session")
def serve() -> Callable[..., AbstractContextManager[Service]]:
    """Start a service of the test's own: as `serving`."""
    return serving


@contextmanager
def celery_worker(folder: Path, environment: dict[str, str]) -> Iterator[None]:
    command = [sys.executable, "-m", "celery", "-A", "sawmill_worker.celery_app", "worker"]
    with process(command, environment, folder / "celery.log"):
        yield


@pytest.fixture(scope="session")
def embedded(tmp_path_factory: pytest.TempPathFactory, offline: Offline) -> Iterator[Service]:
    """A service with workers of its own and no examples, for tests that each make a scanner of their own."""
    environment = {**offline.variables, "SAWMILL_HEARTBEAT_S": "1"}  # a cancelled job ends soon
    with serving(tmp_path_factory.mktemp("embedded"), environment, "--no-examples") as service:
        yield service


# What compose starts does a job by Celery every day (test_composed.py).
@pytest.fixture(params=first_by_day(1, ["embedded", "celery"]))
def engine(request: pytest.FixtureRequest, tmp_path: Path, offline: Offline) -> Iterator[Service]:
    """A service on each engine in turn: with workers of its own, and with a Celery worker woken through Redis."""
    if request.param == "embedded":
        yield request.getfixturevalue("embedded")
        return
    broker = {"SAWMILL_BROKER_URL": request.getfixturevalue("redis_url"), "SAWMILL_DATA_FOLDER": str(tmp_path / "data")}
    environment = {**offline.variables, **broker}
    with celery_worker(tmp_path, environment), serving(tmp_path, environment, "--no-examples") as service:
        yield service


@dataclass(frozen=True)
class MillScan:
    """A stack of counts as a mill takes it, and what is true of it."""

    path: Path
    scanner: Scanner
    theta: Theta
    log_image: np.ndarray


@pytest.fixture(scope="session")
def write_phantom_scan() -> Callable[..., None]:
    """Write a scan of the phantom alone, taken with a geometry."""

    def write(path: Path, theta: Theta, *, views: int = 60, seed: int = 3) -> None:
        write_stack(path, [L_SHAPE.of_density(SAPWOOD_PER_MM)], theta, views=views, seed=seed)

    return write


def write_stack(path: Path, slices: list[Any], theta: Theta, *, views: int, seed: int) -> None:
    angles = (np.arange(views) + 0.5) * 2 * np.pi / views
    stack = simulate_stack(slices, FanBeamGeometry(SCANNER, theta, angles), seed=seed)
    write_simulated_scan(path, stack, angles, detector_pitch_mm=SCANNER.detector_pitch_mm, row_pitch_mm=ROW_PITCH_MM)


@pytest.fixture(scope="session")
def mill_scan(tmp_path_factory: pytest.TempPathFactory) -> MillScan:
    """A log with the phantom on its sawn end: phantom rows, then log rows."""
    path = tmp_path_factory.mktemp("mill") / "stack.h5"
    log = LogModel.random(41)
    wood = L_SHAPE.of_density(SAPWOOD_PER_MM).moved(-4.0, 2.5)
    pieces = [log.slice_at(150.0 + ROW_PITCH_MM * row) for row in range(LOG_ROWS)]
    write_stack(path, [wood] * PHANTOM_ROWS + pieces, THETA, views=VIEWS, seed=41)
    return MillScan(path, SCANNER, THETA, pieces[0].rasterise(256, 400.0))


@pytest.fixture
def events() -> Callable[[Service, str], list[dict[str, Any]]]:
    """What a job's stream of server-sent events tells until its end."""

    def follow(service: Service, job_id: str) -> list[dict[str, Any]]:
        reported: list[dict[str, Any]] = []
        with service.client.stream("GET", f"/v1/jobs/{job_id}/events", timeout=JOB_S) as response:
            assert response.headers["content-type"].startswith("text/event-stream")
            name = ""
            for line in response.iter_lines():
                if line.startswith("event: "):
                    name = line.removeprefix("event: ")
                elif line.startswith("data: ") and name == "job":
                    reported.append(json.loads(line.removeprefix("data: ")))
                elif line.startswith("data: ") and name == "end":
                    return reported
        raise AssertionError("the stream ended without its event `end`")

    return follow
