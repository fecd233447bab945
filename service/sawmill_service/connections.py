"""Connections: how many are open, how long each may keep the service waiting, and which one gives way to another."""

import asyncio
import socket
import struct
import sys
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from http import HTTPStatus
from ipaddress import ip_address, ip_network
from typing import Any

import h11
import prometheus_client
import structlog
from prometheus_client import CollectorRegistry
from uvicorn.protocols.http.h11_impl import H11Protocol

from sawmill_service.callers import network_of
from sawmill_service.lingering import LingeringTransport
from sawmill_service.listening import is_loopback
from sawmill_service.problems import COME_BACK, Refused, refusal_response
from sawmill_service.request_ids import HEADER, named_request
from sawmill_service.settings import ServiceSettings
from sawmill_service.unreadable import refusal_of

# h11 bounds a head of which a part has come, but not one that comes whole: it is given parts of this many bytes.
_HEAD_PART_BYTES = 4096
# A body or a download that stands still for less than this may be a line that lost a packet.
_STUCK_S = 5.0
# Where Linux has the number of acknowledged bytes in its `struct tcp_info` (since 4.2).
_BYTES_ACKED_AT = 120
_TOO_MANY = Refused(503, "too-many-connections", "too many connections are open: try again in a moment", COME_BACK)

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class Patience:
    """How long a client may keep the service waiting.

    Attributes
    ----------
    head_s
        For a whole head, from the connection's beginning or the end of the answer before.
    silence_s, least_bytes_per_s
        A client that reads less of its answer in this time than this rate asks for is cut off.
    """

    head_s: float
    silence_s: float
    least_bytes_per_s: float


class Connections:
    """All connections: their number in all and from each network is bounded, and so is the wait for each.

    Where there is no room, the connection that has waited longest for a head gives way to the new one: a flood of
    half-sent heads does not keep others out. A body or an answer that stands still comes next.

    Parameters
    ----------
    settings
        The bounds.
    registry
        Where those refused and closed are counted.
    """

    def __init__(self, settings: ServiceSettings, registry: CollectorRegistry) -> None:
        self.patience = Patience(settings.head_timeout_s, settings.client_silence_s, settings.min_client_bytes_per_s)
        self._proxies = [ip_network(proxy, strict=False) for proxy in settings.trusted_proxies]
        self._most, self._most_per_address = settings.max_connections, settings.max_connections_per_address
        # In the order in which they began to wait for a head; those in the middle of a request are among them.
        self._open: dict[ClientConnection, None] = {}
        self._from: Counter[str] = Counter()
        self._closed = prometheus_client.Counter(
            "sawmill_http_connections_closed",
            "Connections that were refused or cut off.",
            ["reason"],
            registry=registry,
        )

    def admit(self, connection: "ClientConnection") -> bool:
        """Whether there is room for a new connection, after another one gave way if need be."""
        if not (self._has_room_of_its_own(connection) and self._has_room()):
            self.note("refused")
            return False
        self._open[connection] = None
        self._from[connection.network] += 1
        return True

    def waits_again(self, connection: "ClientConnection") -> None:
        """A connection has its answer: of those that wait for a head it is the last."""
        if connection in self._open:
            del self._open[connection]
            self._open[connection] = None

    def forget(self, connection: "ClientConnection") -> None:
        """A connection has ended, whether it was admitted or not."""
        if connection in self._open:
            del self._open[connection]
            self._from[connection.network] -= 1
            if not self._from[connection.network]:
                del self._from[connection.network]

    def look(self) -> None:
        """End what has kept the service waiting for too long."""
        for connection in list(self._open):
            connection.look()

    def note(self, reason: str) -> None:
        """Count a connection that the service ended."""
        self._closed.labels(reason).inc()

    def _has_room(self) -> bool:
        return len(self._open) < self._most or self._make_room(self._open)

    def _has_room_of_its_own(self, connection: "ClientConnection") -> bool:
        """Room for one network's connections; a proxy's bring everybody's requests."""
        network = connection.network
        if self._from[network] < self._most_per_address or self._may_be_a_proxy(connection.client):
            return True
        return self._make_room([other for other in self._open if other.network == network])

    def _may_be_a_proxy(self, client: tuple[str, int] | None) -> bool:
        if client is None:
            return False
        return is_loopback(client[0]) or any(ip_address(client[0]) in proxy for proxy in self._proxies)

    def _make_room(self, among: Collection["ClientConnection"]) -> bool:
        gives_way = next((connection for connection in among if connection.awaits_head), None)
        if gives_way is None:
            stuck = [connection for connection in among if connection.waited_s() > _STUCK_S]
            gives_way = max(stuck, key=ClientConnection.waited_s, default=None)
        if gives_way is None:
            return False
        self.note("gave-way")
        self.forget(gives_way)
        gives_way.transport.abort()
        return True


class ClientConnection(H11Protocol):
    """One connection, which ends when its client keeps the service waiting.

    Parameters
    ----------
    connections
        All of them.
    """

    def __init__(self, *args: Any, connections: Connections, **options: Any) -> None:  # noqa: ANN401 - uvicorn's own
        super().__init__(*args, **options)
        self._connections = connections
        self._free_since = self._heard_at = self._read_at = self._pace_since = self.loop.time()
        self._read_bytes = self._pace_from_bytes = 0
        self._unread = False

    @cached_property
    def network(self) -> str:
        """Where its client is; "" where it had gone before it could be asked."""
        return network_of(self.client[0]) if self.client else ""

    @property
    def awaits_head(self) -> bool:
        """Whether the next request has not come whole, or not begun."""
        return self.cycle is None or self.cycle.response_complete

    def waited_s(self) -> float:
        """How long the service has waited for its client; 0: the client waits for the service."""
        now = self.loop.time()
        if self._unread:
            return now - self._read_at
        if self.awaits_head:
            return now - self._free_since
        if self.cycle.more_body and not self.cycle.message_event.is_set():
            return now - self._heard_at
        return 0.0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a connection, or answer that there are too many."""
        super().connection_made(transport)
        self.transport = self._staged = LingeringTransport(transport, self.loop, self._more_may_come)
        if not self._connections.admit(self):
            self._refuse(_TOO_MANY)

    def connection_lost(self, exc: Exception | None) -> None:
        """Make room for another."""
        self._connections.forget(self)
        self._staged.forget()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Read on; a head in small parts, so that its length is bounded however it comes."""
        self._heard_at = self.loop.time()
        if self._staged.lingers:
            self._staged.throw_away(data)
            return
        while data and self.conn.their_state is not h11.SEND_BODY and not self.transport.is_closing():
            super().data_received(data[:_HEAD_PART_BYTES])
            data = data[_HEAD_PART_BYTES:]
        if data and not self.transport.is_closing():
            super().data_received(data)

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        self._free_since = self.loop.time()
        self._connections.waits_again(self)
        super().on_response_complete()

    def send_400_response(self, msg: str) -> None:  # noqa: ARG002 - uvicorn's, which is the same for all
        """Answer what is no HTTP, or has a head that is too large, while h11's complaint about it is handled."""
        if self.cycle is not None and self.cycle.response_started and self.conn.our_state is not h11.IDLE:
            self.transport.close()  # the request has its answer, or a part of it
        else:
            self._connections.note("unreadable")
            self._refuse(refusal_of(sys.exception()))

    def shutdown(self) -> None:
        """End in order, as uvicorn asks; what was closed already is cut off with the others."""
        if not self.transport.is_closing():
            super().shutdown()

    def look(self) -> None:
        """Close it if its client has kept the service waiting for too long."""
        unread, self._unread = self._unread, self.transport.get_write_buffer_size() > 0
        if self._unread:
            self._look_at_reading(begins=not unread)
        elif self.awaits_head and not self.transport.is_closing() and self.waited_s() > self._patience.head_s:
            self._give_up_head()

    @property
    def _patience(self) -> Patience:
        return self._connections.patience

    def _look_at_reading(self, *, begins: bool) -> None:
        """Whether the client's system takes its answer at the least rate, over each span of the longest silence."""
        now, taken = self.loop.time(), _acknowledged_bytes(self.transport.get_extra_info("socket"))
        if begins or taken > self._read_bytes:
            self._read_at, self._read_bytes = now, taken
        span_s = self._patience.silence_s
        if begins or taken - self._pace_from_bytes >= self._patience.least_bytes_per_s * span_s:
            self._pace_since, self._pace_from_bytes = now, taken
        elif now - self._pace_since > span_s:
            self._connections.note("slow-answer")
            self.transport.abort()

    def _give_up_head(self) -> None:
        self._connections.note("slow-head")
        begun = self.conn.trailing_data[0]
        if begun and self.conn.their_state is h11.IDLE:
            seconds = f"{self._patience.head_s:g} s"
            detail = f"the request's head has not come whole within {seconds}: send it at once"
            self._refuse(Refused(408, "slow-head", detail, COME_BACK))
        else:
            self.transport.abort()

    def _more_may_come(self) -> bool:
        """Whether the client is in the middle of a body, or has sent more than what was answered."""
        state = self.conn.their_state
        return state in {h11.SEND_BODY, h11.ERROR} or (state is not h11.IDLE and bool(self.conn.trailing_data[0]))

    def _refuse(self, refused: Refused) -> None:
        """Answer without the application, which knows of no request, or waits for a body in vain."""
        status, code = refused.status_code, refused.code
        with named_request() as request_id:
            answer = refusal_response("", refused)
            answer.headers.update({"Connection": "close", HEADER: request_id})
            log.info("request", method="other", route="unmatched", status=status, code=code, address=self.network)
        head = b"".join(b"%s: %s\r\n" % header for header in answer.raw_headers)
        reason = HTTPStatus(status).phrase.encode()
        self.transport.write(b"HTTP/1.1 %d %s\r\n%s\r\n%s" % (status, reason, head, answer.body))
        if self.cycle is not None:
            self.cycle.disconnected = True
            self.cycle.message_event.set()
        self.transport.close()


def _acknowledged_bytes(connection: socket.socket) -> int:
    """Of what was sent, the bytes that the client's system has acknowledged."""
    information = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _BYTES_ACKED_AT + 8)
    (count,) = struct.unpack_from("=Q", information, _BYTES_ACKED_AT)
    return int(count)
