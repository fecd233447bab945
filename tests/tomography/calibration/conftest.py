"""One thread: what is searched here is so small that threads only wait for each other."""

from collections.abc import Iterator

import numba
import pytest


@pytest.fixture(autouse=True, scope="module")
def _one_thread() -> Iterator[None]:
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    yield
    numba.set_num_threads(before)
