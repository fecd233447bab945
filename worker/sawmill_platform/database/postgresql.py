"""Connections to PostgreSQL that give up on a silent server: libpq waits for ever for one that was paused."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from time import monotonic
from typing import Any, TypeVar

import psycopg
from psycopg.abc import PQGen
from psycopg.waiting import READY_NONE
from sqlalchemy import Engine, event
from sqlalchemy.exc import InvalidatePoolError

# A request answers within five seconds, whichever of these happens: a ping and then an attempt to connect, a statement,
# or a row that another transaction has locked.
_PING_S = 1.5
_CONNECT_S = 2  # psycopg has no shorter one
_ANSWER_S = 4.0
_LOOK_S = 0.1
PARAMETERS: Mapping[str, Any] = {
    "connect_timeout": _CONNECT_S,
    "application_name": "sawmill",
    # The server too gives up a statement whose answer nobody will read, and the locks of a paused worker.
    "options": "-c statement_timeout=3500 -c lock_timeout=3000 -c idle_in_transaction_session_timeout=60000"
    " -c timezone=UTC",
    "keepalives_idle": 10,
    "keepalives_interval": 5,
    "keepalives_count": 3,
}

T = TypeVar("T")


class PatientConnection(psycopg.Connection[Any]):
    """A connection that is closed when the server has not answered for `patience_s` (null: no limit)."""

    patience_s: float | None = _ANSWER_S
    fresh = True

    def wait(self, gen: PQGen[T], interval: float = _LOOK_S, timeout: float | None = None) -> T:
        """Wait for an answer; psycopg calls this method for everything that a connection waits for."""
        return super().wait(gen if self.patience_s is None else self._bounded(gen, self.patience_s), interval, timeout)

    def _bounded(self, gen: PQGen[T], patience_s: float) -> PQGen[T]:
        until = monotonic() + patience_s
        try:
            wanted = next(gen)
            while True:
                ready = yield wanted
                if ready == READY_NONE and monotonic() > until:
                    self.pgconn.finish()
                    raise psycopg.OperationalError(f"the server has not answered for {patience_s:g} s")
                wanted = gen.send(ready)
        except StopIteration as end:
            answer: T = end.value
            return answer

    def ping(self) -> None:
        """Check, outside of any transaction, that the server answers."""
        with self._patience(_PING_S):
            self.autocommit = True
            self.execute("SELECT 1")
            self.autocommit = False

    @contextmanager
    def unlimited(self) -> Iterator[None]:
        """Let the statements of one transaction take any time, for transactions that change tables."""
        self.execute("SET LOCAL statement_timeout = 0")
        self.execute("SET LOCAL lock_timeout = 0")
        with self._patience(None):
            yield

    @contextmanager
    def _patience(self, patience_s: float | None) -> Iterator[None]:
        before, self.patience_s = self.patience_s, patience_s
        try:
            yield
        finally:
            self.patience_s = before


def make_patient(engine: Engine) -> None:
    """Have an engine use patient connections, and ping connections that were used before."""
    event.listen(engine, "do_connect", _connect)
    event.listen(engine, "checkout", _ping)


def _connect(_dialect: object, _record: object, arguments: list[Any], parameters: dict[str, Any]) -> PatientConnection:
    return PatientConnection.connect(*arguments, **{**PARAMETERS, **parameters})


def _ping(connection: PatientConnection, _record: object, _proxy: object) -> None:
    if connection.fresh:
        connection.fresh = False
        return
    try:
        connection.ping()
    except psycopg.Error as error:
        raise InvalidatePoolError from error  # discard all connections of that age, and connect again
