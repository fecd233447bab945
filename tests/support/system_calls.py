"""Faults at calls of the system: a disk that refuses, a machine without processes to give, a kill at any moment.

Python announces these calls to its audit hooks (docs.python.org, "Audit events table"), which may raise an exception in
place of the call. So a test names a call and a path, as a machine would refuse it, and nothing of the product.
"""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

Fault = Callable[[str], object]
_faults: list[tuple[str, str, Fault]] = []


def _announce(call: str, arguments: tuple[Any, ...]) -> None:
    for name, below, fault in tuple(_faults):
        if call == name and (path := _path_of(arguments)).startswith(below):
            fault(path)


def _path_of(arguments: tuple[Any, ...]) -> str:
    first = arguments[0] if arguments else ""
    return os.fsdecode(first) if isinstance(first, str | bytes | os.PathLike) else ""


@contextmanager
def at_call(call: str, fault: Fault, *, below: Path | str = "") -> Iterator[None]:
    """Let something happen just before each call of the system, within the block, in every thread.

    `call` is the name of an audit event; the fault is called with the path, and what it raises the call raises; `below`
    is the beginning of the paths (the first argument of the call) at which it happens.
    """
    entry = (call, str(below), fault)
    _faults.append(entry)
    try:
        yield
    finally:
        _faults.remove(entry)


def refusing(number: int, *, times: int | None = None) -> Fault:
    """Make a fault that refuses the call with an error number, each time or as often as that."""
    left = times

    def refuse(path: str) -> None:
        nonlocal left
        if left is None or left > 0:
            left = None if left is None else left - 1
            raise OSError(number, os.strerror(number), path)

    return refuse


sys.addaudithook(_announce)  # as long as the process: hooks cannot be removed
