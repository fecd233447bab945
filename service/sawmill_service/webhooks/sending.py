"""An attempt to deliver a message: to a checked address, without redirects and proxies, within a time limit."""

import asyncio
import socket
import ssl
import threading
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from functools import cache, partial
from http import HTTPStatus
from typing import NamedTuple

import httpcore

from sawmill_platform.contracts.webhooks import Destination, destination_of
from sawmill_service.http.responses.conditional import http_date
from sawmill_service.webhooks.destinations import AllowedDestinations, RefusedDestinationError

# Time limit of an attempt; the specification recommends 15 to 30 s.
LIMIT_S = 15.0
_LONGEST_REASON = 300

# Function of a host and a port that finds the addresses, as texts.
Resolve = Callable[[str, int], Awaitable[list[str]]]


class DeliveryAnswer(NamedTuple):
    """Outcome of an attempt."""

    status: int | None  # HTTP status of the answer; None: there was no answer
    reason: str | None = None  # reason why the message was not delivered; None: it was delivered
    retry_after_s: float = 0.0  # wait that the receiver asks for, s


async def resolve(host: str, port: int) -> list[str]:
    """Find the addresses of a name with the system's resolver.

    The resolver may hang: then its thread is left behind, and ends with the process.

    Raises
    ------
    OSError
        The name has no address.
    """
    loop = asyncio.get_running_loop()
    resolved: asyncio.Future[list[str]] = loop.create_future()

    def look_up() -> None:
        try:
            addresses = [str(place[0]) for *_, place in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)]
            tell = partial(_settle, resolved, addresses)
        except OSError as error:
            tell = partial(_settle, resolved, error)
        except UnicodeError:  # a part of more than 63 letters, which no name of the DNS has
            tell = partial(_settle, resolved, socket.gaierror(socket.EAI_NONAME, "it is too long"))
        with suppress(RuntimeError):  # the loop has ended
            loop.call_soon_threadsafe(tell)

    threading.Thread(target=look_up, name="resolver", daemon=True).start()
    return await resolved


def _settle(resolved: "asyncio.Future[list[str]]", result: list[str] | OSError) -> None:
    if resolved.done():  # nobody waits any more
        return
    if isinstance(result, OSError):
        resolved.set_exception(result)
    else:
        resolved.set_result(list(dict.fromkeys(result)))


@cache
def system_certificates() -> ssl.SSLContext:
    """Return a context that verifies certificates by the system's own store, to which a mill adds its authority."""
    return ssl.create_default_context()


class WebhookSending:
    """Sender of messages to allowed destinations."""

    def __init__(
        self,
        allowed: AllowedDestinations,
        *,
        resolve: Resolve = resolve,
        certificates: Callable[[], ssl.SSLContext] = system_certificates,
        limit_s: float = LIMIT_S,
    ) -> None:
        self._allowed = allowed
        self._resolve = resolve
        self._certificates = certificates
        self._limit_s = limit_s

    async def post(self, url: str, headers: Mapping[str, str], body: bytes) -> DeliveryAnswer:
        """Send a message once; any failure is an answer with its reason."""
        destination = destination_of(url)
        try:
            async with asyncio.timeout(self._limit_s):
                return await self._post(destination, {"Host": destination.authority, **headers}, body)
        except TimeoutError:
            return DeliveryAnswer(None, f"there was no answer within {self._limit_s:g} s")
        except RefusedDestinationError as error:
            return DeliveryAnswer(None, str(error))
        except socket.gaierror as error:
            return DeliveryAnswer(None, f"the name {destination.host!r} cannot be resolved: {error.strerror}")
        except httpcore.RemoteProtocolError:
            return DeliveryAnswer(None, "what it answered is not HTTP, or the connection was closed early")
        except (httpcore.NetworkError, httpcore.TimeoutException, httpcore.ProtocolError, OSError) as error:
            return DeliveryAnswer(None, f"the connection failed: {_cause_of(error)}"[:_LONGEST_REASON])

    async def _post(self, destination: Destination, headers: Mapping[str, str], body: bytes) -> DeliveryAnswer:
        self._allowed.check(destination)
        addresses = self._allowed.check_addresses(await self._resolve(destination.host, destination.port), destination)
        # An address that never answers, as with IPv6 in many networks, leaves time for the other addresses.
        connect_s = self._limit_s / (len(addresses) + 1)
        for address in addresses[:-1]:
            try:
                return await self._post_to(address, destination, headers, body, connect_s)
            except (httpcore.ConnectError, httpcore.ConnectTimeout):
                continue
        return await self._post_to(addresses[-1], destination, headers, body)

    async def _post_to(
        self,
        address: str,
        destination: Destination,
        headers: Mapping[str, str],
        body: bytes,
        connect_s: float | None = None,
    ) -> DeliveryAnswer:
        """Send to the address itself: the name is not looked up again."""
        secure = destination.scheme == "https"
        context = await asyncio.to_thread(self._certificates) if secure else None
        where = httpcore.URL(
            scheme=destination.scheme, host=address, port=destination.port, target=destination.target.encode()
        )
        extensions: dict[str, object] = {"timeout": {"connect": connect_s}}
        if secure:
            extensions["sni_hostname"] = destination.host
        async with (
            httpcore.AsyncConnectionPool(ssl_context=context, max_keepalive_connections=0) as pool,
            pool.stream("POST", where, headers=list(headers.items()), content=body, extensions=extensions) as answer,
        ):
            # The status is enough; the body is not read.
            return _read(answer.status, {name.lower(): value for name, value in answer.headers})


def _read(status: int, headers: Mapping[bytes, bytes]) -> DeliveryAnswer:
    if HTTPStatus.OK <= status < HTTPStatus.MULTIPLE_CHOICES:
        return DeliveryAnswer(status)
    reason = f"it answered {status}"
    if HTTPStatus.MULTIPLE_CHOICES <= status < HTTPStatus.BAD_REQUEST:
        reason += ", and redirects are not followed: change the webhook's URL"
    if status == HTTPStatus.GONE:
        reason += ": it wants no more messages"
    return DeliveryAnswer(status, reason, _wait_s(headers.get(b"retry-after", b"").decode("latin-1").strip()))


def _wait_s(text: str) -> float:
    """Parse `Retry-After` (RFC 9110, section 10.2.3), s; 0 where it is neither seconds nor a date."""
    if text.isascii() and text.isdecimal():
        return float(text[:9])
    date = http_date(text)
    return 0.0 if date is None else max(0.0, (date - datetime.now(UTC)).total_seconds())


def _cause_of(error: BaseException) -> str:
    """Return the message of the system or of TLS; the libraries in between report only a failure."""
    # httpcore keeps the original error as an argument of the error that it raises.
    while inner := error.__cause__ or next((each for each in error.args if isinstance(each, BaseException)), None):
        error = inner
    return str(error) or type(error).__name__
