"""Who acts: set where a request comes in or a command begins, read where rows and log lines name somebody."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass


@dataclass(frozen=True)
class Actor:
    """Somebody who does something, as the audit and the jobs name him.

    Attributes
    ----------
    name : str
        A key's name, or who else it is.
    key_id : str or None
        The key's; None: without one.
    address : str or None
        From which the request came; None: it is no request.
    request_id : str or None
        Of the request.
    of_service : bool
        Whether it is the service, of its own accord.
    """

    name: str
    key_id: str | None = None
    address: str | None = None
    request_id: str | None = None
    of_service: bool = False


THE_SERVICE = Actor("the service", of_service=True)
_ACTING = ContextVar("acting", default=THE_SERVICE)


def actor() -> Actor:
    """Whoever acts in this thread or task; the service itself where nobody else does."""
    return _ACTING.get()


@contextmanager
def acting_as(somebody: Actor) -> Iterator[None]:
    """Within the block, and in the threads and tasks that it starts with its context, somebody acts."""
    token = _ACTING.set(somebody)
    try:
        yield
    finally:
        _ACTING.reset(token)
