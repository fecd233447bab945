"""Real servers, and the scans that they are sent."""

from collections.abc import Callable, Iterator
from functools import cache

import numpy as np
import pytest
from live_service import SCANNER, Offline, Service, serving

from sawmill_calibration.simulation import write_simulated_scan
from sawmill_tomography.geometry.geometry import FanBeamGeometry, Theta
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM
from sawmill_tomography.projection.simulate import simulate_stack

THETA = Theta(0.7, 728.0, -254.0, -37.0, -0.21)


@pytest.fixture(scope="session")
def offline(tmp_path_factory: pytest.TempPathFactory) -> Offline:
    return Offline(tmp_path_factory.mktemp("offline"))


@pytest.fixture(scope="session")
def embedded(tmp_path_factory: pytest.TempPathFactory, offline: Offline) -> Iterator[Service]:
    """A service with workers of its own and no examples, for tests that each make a scanner of their own."""
    environment = {**offline.variables, "SAWMILL_HEARTBEAT_S": "1"}  # a cancelled job ends soon
    with serving(tmp_path_factory.mktemp("embedded"), environment, "--no-examples") as service:
        yield service


@pytest.fixture(scope="session")
def phantom_scan(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., bytes]:
    """Give the file of a scan of the phantom alone, counts of one row, taken with a geometry."""

    @cache
    def scan(theta: Theta = THETA, *, views: int = 60, seed: int = 3) -> bytes:
        path, angles = tmp_path_factory.mktemp("scan") / "scan.h5", (np.arange(views) + 0.5) * 2 * np.pi / views
        stack = simulate_stack([L_SHAPE.of_density(SAPWOOD_PER_MM)], FanBeamGeometry(SCANNER, theta, angles), seed=seed)
        write_simulated_scan(path, stack, angles, SCANNER, 3.0)
        return path.read_bytes()

    return scan
