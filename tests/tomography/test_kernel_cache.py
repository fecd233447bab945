"""Numba's cache in a process that may not write to it."""

import pytest
from numba.core.caching import FunctionCache
from structlog.testing import capture_logs

from sawmill_tomography import kernel_cache
from sawmill_tomography.reconstruction import _fbp_numba


@pytest.fixture
def refused(monkeypatch):
    def refuse(*_):
        raise PermissionError("not here")

    monkeypatch.setattr(FunctionCache, "save_overload", refuse)


@pytest.mark.usefixtures("refused")
def test_a_kernel_that_cannot_be_kept_is_named_in_the_log_and_used():
    kernel_cache.only_read()
    with capture_logs() as log:
        _fbp_numba.lay_out._cache.save_overload(None, None)
    assert [(line["event"], "lay_out" in line["kernel"]) for line in log] == [("kernel-not-kept", True)]


def test_a_module_whose_kernels_nobody_compiled_is_noticed(monkeypatch):
    monkeypatch.setattr(_fbp_numba.lay_out._cache._cache_file, "_load_index", lambda: {"signature": "file"})
    assert kernel_cache._versions(_fbp_numba.lay_out)
    monkeypatch.setattr(_fbp_numba.lay_out._cache._cache_file, "_load_index", dict)
    assert not kernel_cache.holds_all(_fbp_numba)
