"""The small scanner that use cases are tried on."""

import pytest
from small_scanner import calibration, constants, scanner, sinogram, spec, theta, turn  # noqa: F401 - fixtures


@pytest.fixture(autouse=True, scope="module")
def _in_one_thread(one_thread: None) -> None:
    """Their scans are small."""
