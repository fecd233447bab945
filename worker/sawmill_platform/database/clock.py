"""The time that decides: the database server's, or, if the database is a file, the time of the one owner process.

On SQLite a row contains the time at which this machine started; CLOCK_BOOTTIME, which all processes of the machine
share and which nobody can step, gives the time since then. The row is written by the first process that opens the store
after a start of the machine, and from then on by the owner alone, the service of that store. On PostgreSQL the
server's clock is read now and then.
"""

import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from datetime import UTC, datetime
from pathlib import Path

from sqlalchemy import text
from sqlalchemy.orm import Session

from sawmill_platform.database.tables import ClockRow
from sawmill_platform.errors import StorageUnavailable

Clock = Callable[[], datetime]
# Time for which an answer of the database is used: the monotonic clock has hardly drifted by then.
_REFRESH_S = 5.0
_THE_ROW = 1
_SERVER_S = "SELECT extract(epoch FROM clock_timestamp())::double precision"
_BOOT = Path("/proc/sys/kernel/random/boot_id")


def since_boot_s() -> float:
    """Return the seconds since this machine started, suspensions included; a step of the clock does not change them."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


def machine_offset_s() -> float:
    """Return the seconds from 1970 to the start of this machine, by the machine's clock."""
    return time.time() - since_boot_s()


def this_boot() -> str:
    """Return the id of this run of the machine."""
    return _BOOT.read_text().strip()


class SharedClock:
    """Clock for the time stamps of rows and for due times, the same for all processes on one database."""

    def __init__(self, read: Callable[[], AbstractContextManager[Session]]) -> None:
        self._transaction = read
        self._reading = threading.Lock()
        self._offset_s: float | None = None
        self._read_at_s = 0.0

    def __call__(self) -> datetime:
        """Return the present time, in UTC."""
        return datetime.fromtimestamp(self._current_offset_s() + since_boot_s(), UTC)

    def off_s(self) -> float:
        """Return the seconds by which this machine's own clock is ahead."""
        return machine_offset_s() - self._current_offset_s()

    def refresh(self) -> None:
        """Read the database's time at once."""
        self._offset_s, self._read_at_s = self._read(), since_boot_s()

    def _current_offset_s(self) -> float:
        if self._offset_s is None:
            with self._reading:
                if self._offset_s is None:
                    self.refresh()
        elif since_boot_s() - self._read_at_s > _REFRESH_S and self._reading.acquire(blocking=False):
            # One thread asks, the other ones use the value that is known; so does this one if there is no answer.
            try:
                self.refresh()
            except StorageUnavailable:
                self._read_at_s = since_boot_s()
            finally:
                self._reading.release()
        assert self._offset_s is not None  # noqa: S101 - refreshed above, or known
        return self._offset_s

    def _read(self) -> float:
        with self._transaction() as session:
            if session.get_bind().dialect.name == "postgresql":
                asked_at_s = since_boot_s()
                server_s: float = session.execute(text(_SERVER_S)).scalar_one()
                return server_s - 0.5 * (asked_at_s + since_boot_s())
            row = session.get(ClockRow, _THE_ROW)
            # After a start of the machine the row is from an earlier start until a store is opened.
            return row.offset_s if row is not None and row.boot == this_boot() else machine_offset_s()


def set_if_new(session: Session) -> None:
    """Write the machine's time once after each start of the machine; on SQLite alone."""
    if session.get_bind().dialect.name != "sqlite":
        return
    row = session.get(ClockRow, _THE_ROW)
    if row is None:
        session.add(ClockRow(number=_THE_ROW, boot=this_boot(), offset_s=machine_offset_s()))
    elif row.boot != this_boot():
        row.boot, row.offset_s = this_boot(), machine_offset_s()


def set_to(session: Session, offset_s: float) -> None:
    """Set a new time, as its owner; on SQLite alone."""
    row = session.get(ClockRow, _THE_ROW)
    assert row is not None  # noqa: S101 - written when the store was opened
    row.offset_s = offset_s
