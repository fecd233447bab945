"""Faults at calls of the system, as Python announces them to audit hooks (docs.python.org, "Audit events table")."""

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
    """Call `fault` with the path before each such audit event below a path; what it raises, the call raises."""
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
