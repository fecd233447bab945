"""A plugin of pytest with a fixture for each fault of the machine that no test can make for real."""

import os
import shutil
import sqlite3
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
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
