"""The time that decides: of the database's server, or of the one process that owns it where the database is a file.

On SQLite a row says what the time was when this machine started; CLOCK_BOOTTIME, which all its processes share and
which nobody can step, says how long ago that was. The row is written by whoever opens the store first after a start
of the machine, and from then on by the owner alone, the `sawmill serve` of that store. On PostgreSQL the server's clock
is asked now and then.
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
# How long an answer of the database is used: the monotonic clock has hardly drifted by then.
_REFRESH_S = 5.0
_THE_ROW = 1
_SERVER_S = "SELECT extract(epoch FROM clock_timestamp())::double precision"
_BOOT = Path("/proc/sys/kernel/random/boot_id")


def since_boot_s() -> float:
    """Seconds since this machine started, suspensions included; no step of the clock moves it."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


def machine_offset_s() -> float:
    """Seconds since 1970 at the start of this machine, by its own clock."""
    return time.time() - since_boot_s()


def this_boot() -> str:
    """What tells this run of the machine from any other."""
    return _BOOT.read_text().strip()


class SharedClock:
    """The time by which rows are stamped and due times are judged, the same for all processes on one database.

    Parameters
    ----------
    read
        Begins a transaction that reads.
    """

    def __init__(self, read: Callable[[], AbstractContextManager[Session]]) -> None:
        self._transaction = read
        self._reading = threading.Lock()
        self._offset_s: float | None = None
        self._read_at_s = 0.0

    def __call__(self) -> datetime:
        """Now, in UTC.

        Raises
        ------
        StorageUnavailable
            The database does not answer, and never has.
        """
        return datetime.fromtimestamp(self._current_offset_s() + since_boot_s(), UTC)

    def off_s(self) -> float:
        """By how much this machine's own clock is ahead."""
        return machine_offset_s() - self._current_offset_s()

    def refresh(self) -> None:
        """Ask the database at once."""
        self._offset_s, self._read_at_s = self._read(), since_boot_s()

    def _current_offset_s(self) -> float:
        known = self._offset_s
        if known is None:
            with self._reading:
                if self._offset_s is None:
                    self.refresh()
        elif since_boot_s() - self._read_at_s > _REFRESH_S and self._reading.acquire(blocking=False):
            # One thread asks, the others go on with what is known; so does this one where there is no answer.
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
            # After a start of the machine the row is of an earlier one until a store is opened.
            return row.offset_s if row is not None and row.boot == this_boot() else machine_offset_s()


def set_if_new(session: Session) -> None:
    """On SQLite: write the machine's time once after each start of the machine."""
    if session.get_bind().dialect.name != "sqlite":
        return
    row = session.get(ClockRow, _THE_ROW)
    if row is None:
        session.add(ClockRow(number=_THE_ROW, boot=this_boot(), offset_s=machine_offset_s()))
    elif row.boot != this_boot():
        row.boot, row.offset_s = this_boot(), machine_offset_s()


def set_to(session: Session, offset_s: float) -> None:
    """On SQLite: a new time, from its owner."""
    row = session.get(ClockRow, _THE_ROW)
    assert row is not None  # noqa: S101 - written when the store was opened
    row.offset_s = offset_s
