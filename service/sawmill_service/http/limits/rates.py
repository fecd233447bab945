"""Rates of requests and of failed logins, and the names of senders by which limits count."""

import math
import threading
import time
from collections import OrderedDict
from ipaddress import IPv6Address, ip_address, ip_network

from limits import RateLimitItem, parse_many
from limits.storage import MemoryStorage
from limits.strategies import SlidingWindowCounterRateLimiter
from starlette.types import Scope

from sawmill_platform.ledger.events import actor
from sawmill_service.http.problems import Refused

# Number of counts that are kept, some 7 MB. A caller has two or four.
_MOST_COUNTS = 20_000
# Number of wrong secrets that are recognised, 2 MB.
_MOST_WRONG = 10_000
_WRONG_KEYS = "wrong keys"


def too_many(detail: str, retry_after_s: int) -> Refused:
    """Make the refusal of a request that may be sent again later."""
    return Refused(429, "too-many-requests", detail, {"Retry-After": str(retry_after_s)})


def check_rate(text: str) -> str:
    """Check that the library can read a text as one rate or several."""
    try:
        limits = parse_many(text)
    except ValueError as error:
        raise ValueError(_WRONG_RATE.format(text)) from error
    if not all(limit.amount >= 1 for limit in limits):
        raise ValueError(_WRONG_RATE.format(text))
    return text


_WRONG_RATE = "must be as in 1200/minute, or 1200/minute; 50/second, with at least 1, not {!r}"


class BoundedMemory(MemoryStorage):
    """The library's memory with a bound; without one, it inspects all counts in a new thread after each request."""

    def __init__(self, most_counts: int = _MOST_COUNTS) -> None:
        super().__init__()
        self._most_counts = most_counts

    def incr(self, key: str, expiry: float, amount: int = 1) -> int:
        """Add to a count."""
        if self.get(key) == 0:
            self._make_room()
            self.expirations[key] = time.time() + expiry
        self.storage[key] += amount
        return self.storage[key]

    def _make_room(self) -> None:
        if len(self.expirations) < self._most_counts:
            return
        now = time.time()
        gone = [key for key, expires in self.expirations.items() if expires <= now]
        for key in gone or list(self.expirations)[: max(1, self._most_counts // 10)]:
            self.clear(key)


class Rates:
    """Counts by name in sliding windows."""

    def __init__(self, limits: str) -> None:
        self._limits = parse_many(limits)
        self._windows = SlidingWindowCounterRateLimiter(BoundedMemory())
        self._lock = threading.Lock()

    def take(self, *name: str) -> None:
        """Count one request."""
        with self._lock:
            for limit in self._limits:
                if not self._windows.hit(limit, *name):
                    raise self._refusal(limit, name)

    def _refusal(self, limit: RateLimitItem, name: tuple[str, ...]) -> Refused:
        wait_s = max(1, math.ceil(self._windows.get_window_stats(limit, *name).reset_time - time.time()))
        kind, caller = name[0], name[-1]
        return too_many(
            f"{caller} may send {limit.amount} {kind} in {limit.get_expiry()} s, and has: try again in {wait_s} s",
            wait_s,
        )


class FailedLogins:
    """Wrong secrets by address. Beyond a rate, further wrong secrets get 429; a valid secret is accepted all the same.

    A wrong secret that is sent again is recognised, and neither looked up nor counted: a program that continues with
    an expired key guesses nothing.
    """

    def __init__(self, limits: str) -> None:
        self._rates = Rates(limits)
        self._wrong: OrderedDict[tuple[str, str], None] = OrderedDict()

    def knows(self, address: str, secret_hash: str) -> bool:
        """Return whether this address has sent this wrong secret before."""
        return (network_of(address), secret_hash) in self._wrong

    def failed(self, address: str, secret_hash: str) -> None:
        """Count a wrong secret from an address."""
        network = network_of(address)
        self._wrong[network, secret_hash] = None
        if len(self._wrong) > _MOST_WRONG:
            self._wrong.popitem(last=False)
        self._rates.take(_WRONG_KEYS, network)


def who(scope: Scope) -> str:
    """Return the name under which a request is counted: the key that it brought, or the client's network."""
    key_id = actor().key_id
    if key_id is not None:
        return f"key {key_id}"
    client: tuple[str, int] | None = scope.get("client")
    return network_of(client[0]) if client else "an unknown client"


def network_of(address: str) -> str:
    """Return an IPv4 address, or the /64 of an IPv6 address, which one subscriber has; any other text unchanged."""
    try:
        ip = ip_address(address.partition("%")[0])
    except ValueError:  # a text that a proxy has put there
        return address[:64]
    if not isinstance(ip, IPv6Address):
        return str(ip)
    return str(ip.ipv4_mapped or ip_network((ip, 64), strict=False))
