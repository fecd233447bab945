"""The actor: set where a request comes in or a command starts, read where rows and log lines name the actor."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass


@dataclass(frozen=True)
class Actor:
    """A person or program that acts, with the name that the audit and the jobs show."""

    name: str  # name of the key, or another name of the actor
    key_id: str | None = None  # id of the key; None: no key
    address: str | None = None  # address from which the request came; None: there is no request
    request_id: str | None = None  # id of the request
    of_service: bool = False  # True if the service acts by itself


THE_SERVICE = Actor("the service", of_service=True)
_ACTING = ContextVar("acting", default=THE_SERVICE)


def actor() -> Actor:
    """Return the actor of this thread or task; the service itself if none is set."""
    return _ACTING.get()


@contextmanager
def acting_as(somebody: Actor) -> Iterator[None]:
    """Set the actor within the block, and in the threads and tasks that the block starts with its context."""
    token = _ACTING.set(somebody)
    try:
        yield
    finally:
        _ACTING.reset(token)
