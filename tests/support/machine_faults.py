"""A fixture (as a plugin) for each fault of the machine that no test can make for real, and faults at system calls."""

import os
import shutil
import sqlite3
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn, Protocol

import pytest
from sqlalchemy import event

from sawmill_platform.database.database import Database
from sawmill_platform.errors import StorageUnavailable


class FullDisk(Protocol):
    """Leaves this number of bytes free on every disk, from now on."""

    def __call__(self, free_bytes: int, *, size_bytes: int = ...) -> None: ...


class MovedClock(Protocol):
    """Moves the wall clock ahead of the right time, or stops it; CLOCK_BOOTTIME and the monotonic clock go on."""

    def __call__(self, *, ahead_s: float = ..., stands_at_s: float | None = ...) -> None: ...


@pytest.fixture
def full_disk(monkeypatch: pytest.MonkeyPatch) -> FullDisk:
    """Give a function that leaves a number of bytes free on every disk."""

    def leave(free_bytes: int, *, size_bytes: int = 10**12) -> None:
        usage = SimpleNamespace(total=size_bytes, used=size_bytes - free_bytes, free=free_bytes)
        monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)

    return leave


@pytest.fixture
def moved_clock(monkeypatch: pytest.MonkeyPatch) -> MovedClock:
    """Give a function that sets this process's wall clock, as often as it is called."""
    right = time.time

    def move(*, ahead_s: float = 0.0, stands_at_s: float | None = None) -> None:
        monkeypatch.setattr(time, "time", lambda: right() + ahead_s if stands_at_s is None else stands_at_s)

    return move


@pytest.fixture
def read_only_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every disk says that it is mounted read-only."""
    look = os.statvfs

    def read_only(path: Any) -> os.statvfs_result:
        found = look(path)
        return os.statvfs_result((*found[:8], found.f_flag | os.ST_RDONLY, found.f_namemax))

    monkeypatch.setattr(os, "statvfs", read_only)


@pytest.fixture
def without_network(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fail the test where a name is looked up, with which every connection of ours begins."""

    def look_up(*_: object, **__: object) -> NoReturn:
        pytest.fail("a name was looked up")

    monkeypatch.setattr("socket.getaddrinfo", look_up)


@contextmanager
def database_away(database: Database) -> Iterator[threading.Event]:
    """Let SQLite fail to open its file within the block, and set the event when somebody has met that."""
    met = threading.Event()

    def fail(*_: object) -> NoReturn:
        met.set()
        error = sqlite3.OperationalError("disk I/O error")
        error.sqlite_errorcode, error.sqlite_errorname = sqlite3.SQLITE_IOERR, "SQLITE_IOERR"
        raise error

    event.listen(database.engine, "do_connect", fail)
    database.engine.dispose()
    try:
        yield met
    finally:
        event.remove(database.engine, "do_connect", fail)
    while not _answers(database):
        time.sleep(0.01)


def _answers(database: Database) -> bool:
    try:
        with database.read():
            return True
    except StorageUnavailable:
        return False


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
