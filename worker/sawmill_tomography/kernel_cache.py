"""Numba's cache of compiled kernels: its content, and how a process continues that may only read the cache."""

from types import ModuleType
from typing import Any

import structlog
from numba.core.caching import FunctionCache
from numba.core.dispatcher import Dispatcher


def holds_all(*modules: ModuleType) -> bool:
    """Return whether the cache has a version of every cached kernel of these modules."""
    kernels = [kernel for module in modules for kernel in vars(module).values() if _is_cached(kernel)]
    # The index has no version where the file has changed since.
    return all(kernel._cache._cache_file._load_index() for kernel in kernels)  # noqa: SLF001


def only_read() -> None:
    """Make Numba keep no compiled kernel, instead of failing, where this process may not write the cache."""
    cached: Any = FunctionCache
    keep = cached.save_overload

    def keep_if_allowed(cache: Any, signature: object, compiled: object) -> None:  # noqa: ANN401 - Numba has no types
        try:
            keep(cache, signature, compiled)
        except PermissionError as error:
            structlog.get_logger().warning("kernel-not-kept", kernel=cache._name, reason=str(error))  # noqa: SLF001

    cached.save_overload = keep_if_allowed


def _is_cached(kernel: Any) -> bool:  # noqa: ANN401
    return isinstance(kernel, Dispatcher) and isinstance(getattr(kernel, "_cache", None), FunctionCache)
