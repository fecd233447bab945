"""Numba's cache in a process that may not write to it."""

import errno
import sys
from importlib import import_module

import pytest
from numba.core.caching import FunctionCache
from structlog.testing import capture_logs
from system_calls import at_call, refusing

from sawmill_tomography import kernel_cache

KERNEL = """
from numba import njit

@njit(cache=True)
def double(number):
    return 2 * number
"""


@pytest.fixture
def kernels(tmp_path, monkeypatch):
    """A module with a kernel that nobody has compiled."""
    (tmp_path / "kernels_of_a_test.py").write_text(KERNEL)
    monkeypatch.syspath_prepend(tmp_path)
    yield import_module("kernels_of_a_test")
    del sys.modules["kernels_of_a_test"]


@pytest.fixture
def only_read():
    """What a process of an attempt does to Numba for good, and this process only for a test."""
    keep = FunctionCache.save_overload
    kernel_cache.only_read()
    yield
    FunctionCache.save_overload = keep


@pytest.mark.usefixtures("only_read")
def test_a_kernel_that_cannot_be_kept_is_named_in_the_log_and_used(kernels, tmp_path):
    with capture_logs() as log, at_call("os.rename", refusing(errno.EACCES), below=tmp_path):
        assert kernels.double(3) == 6
    assert [(line["event"], "double" in line["kernel"]) for line in log] == [("kernel-not-kept", True)]


def test_a_module_whose_kernels_nobody_compiled_is_noticed(kernels):
    assert not kernel_cache.holds_all(kernels)
    assert kernels.double(3) == 6
    assert kernel_cache.holds_all(kernels)
