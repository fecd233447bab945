"""Report for operators: whether the broker answers."""

import time
from typing import NamedTuple
from urllib.parse import urlsplit

from redis import Redis
from redis.exceptions import AuthenticationError, NoPermissionError, RedisError

# A page waits for the answer.
PATIENCE_S = 0.5


class BrokerReport(NamedTuple):
    """Report on Redis, which carries wake-ups: without Redis jobs start a few seconds later."""

    host: str  # host and port, without the password
    answered_s: float | None  # time until the answer; None: there was no answer
    refused: bool = False  # whether Redis answered that the user or the password is wrong

    @property
    def trouble(self) -> str | None:
        """Sentence on what is wrong, without the host, so that anybody may read it; None: nothing is wrong."""
        if self.refused:
            return "Redis refuses the user or the password in SAWMILL_BROKER_URL"
        return "Redis (SAWMILL_BROKER_URL) does not answer" if self.answered_s is None else None


def report_of(broker_url: str) -> BrokerReport:
    """Query the broker."""
    host = urlsplit(broker_url).hostname or "?"
    started = time.perf_counter()
    try:
        with Redis.from_url(broker_url, socket_connect_timeout=PATIENCE_S, socket_timeout=PATIENCE_S) as redis:
            redis.ping()
    except (AuthenticationError, NoPermissionError):
        return BrokerReport(host, None, refused=True)
    except (RedisError, ValueError):  # Redis is away, or the address is not one of Redis
        return BrokerReport(host, None)
    return BrokerReport(host, time.perf_counter() - started)
