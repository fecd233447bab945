"""Whether the broker answers, for those who run the service."""

import time
from typing import NamedTuple
from urllib.parse import urlsplit

from redis import Redis
from redis.exceptions import AuthenticationError, NoPermissionError, RedisError

# A page waits for it.
PATIENCE_S = 0.5


class BrokerReport(NamedTuple):
    """Redis, which carries wake-ups: without it jobs begin a few seconds later.

    Attributes
    ----------
    host : str
        Where it is, without its password.
    answered_s : float or None
        How long it took to answer; None: it did not.
    refused : bool
        Whether it answered that the user or the password is wrong.
    """

    host: str
    answered_s: float | None
    refused: bool = False

    @property
    def trouble(self) -> str | None:
        """What is wrong, without the host, for anybody may read it; None: nothing is."""
        if self.refused:
            return "Redis refuses the user or the password in SAWMILL_BROKER_URL"
        return "Redis (SAWMILL_BROKER_URL) does not answer" if self.answered_s is None else None


def report_of(broker_url: str) -> BrokerReport:
    """Ask it."""
    host = urlsplit(broker_url).hostname or "?"
    started = time.perf_counter()
    try:
        with Redis.from_url(broker_url, socket_connect_timeout=PATIENCE_S, socket_timeout=PATIENCE_S) as redis:
            redis.ping()
    except (AuthenticationError, NoPermissionError):
        return BrokerReport(host, None, refused=True)
    except (RedisError, ValueError):  # it is away, or the address is none of Redis's
        return BrokerReport(host, None)
    return BrokerReport(host, time.perf_counter() - started)
