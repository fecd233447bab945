"""Real servers, and the scans that they are sent."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_service import SCANNER, Offline, Service, serving

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


@pytest.fixture(scope="session")
def embedded(tmp_path_factory: pytest.TempPathFactory, offline: Offline) -> Iterator[Service]:
    """A service with workers of its own and no examples, for tests that each make a scanner of their own."""
    environment = {**offline.variables, "SAWMILL_HEARTBEAT_S": "1"}  # a cancelled job ends soon
    with serving(tmp_path_factory.mktemp("embedded"), environment, "--no-examples") as service:
        yield service


@dataclass(frozen=True)
class MillScan:
    """A stack of counts as a mill takes it, and what is true of it."""

    path: Path
    scanner: Scanner
    theta: Theta


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
    return MillScan(path, SCANNER, THETA)
