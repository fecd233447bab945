"""What is searched here is so small that threads only wait for each other."""

import pytest


@pytest.fixture(autouse=True, scope="module")
def _in_one_thread(one_thread: None) -> None:
    """Every test of this room."""
