"""Which connection gives way to another, and what a head may be: on transports without a network."""

import asyncio
import json
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import uvicorn
from prometheus_client import CollectorRegistry
from uvicorn.server import ServerState

from sawmill_service.callers import network_of
from sawmill_service.connections import ClientConnection, Connections
from sawmill_service.listening import ListenError
from sawmill_service.open_files import open_files_for
from sawmill_service.settings import ServiceSettings

WHOLE_HEAD = b"GET / HTTP/1.1\r\nHost: a\r\n\r\n"


class Transport(asyncio.Transport):
    """Keeps what is written, and never reads."""

    def __init__(self, address: str) -> None:
        super().__init__({"peername": (address, 40_000), "sockname": ("192.0.2.1", 8000)})
        self.written, self.closed = b"", False

    def write(self, data: Any) -> None:
        self.written += data

    def get_write_buffer_size(self) -> int:
        return 0

    def is_closing(self) -> bool:
        return self.closed

    def write_eof(self) -> None:
        self.closed = True

    def resume_reading(self) -> None:
        pass

    def close(self) -> None:
        self.closed = True

    abort = close


class Doorway:
    """Opens connections to an application that never answers."""

    def __init__(self, loop: asyncio.AbstractEventLoop, **bounds: Any) -> None:
        self._loop = loop
        self._config = uvicorn.Config(self._busy, log_config=None, ws="none", lifespan="off")
        self._connections = Connections(ServiceSettings(**bounds), CollectorRegistry())

    async def _busy(self, _scope: Any, _receive: Any, _send: Any) -> None:
        await asyncio.sleep(60.0)

    def open(self, address: str, sent: bytes = b"") -> Transport:
        transport = Transport(address)
        connection = ClientConnection(self._config, ServerState(), {}, _loop=self._loop, connections=self._connections)
        connection.connection_made(transport)
        if sent and not transport.closed:
            connection.data_received(sent)
        return transport


@pytest.fixture
def doorway() -> Iterator[Callable[..., Doorway]]:
    """Make doorways with bounds; they last until their loop has ended what is open."""
    made = []
    with asyncio.Runner() as runner:

        def make(**bounds: Any) -> Doorway:
            made.append(Doorway(runner.get_loop(), **bounds))
            return made[-1]

        yield make


def test_the_oldest_without_a_whole_head_gives_way(doorway):
    door = doorway(max_connections=3)
    busy = door.open("192.0.2.2", WHOLE_HEAD)
    half, silent = door.open("192.0.2.3", b"GET"), door.open("192.0.2.4")
    newest = [door.open("192.0.2.5"), door.open("192.0.2.6")]
    assert (busy.closed, half.closed, silent.closed) == (False, True, True)
    assert [transport.closed for transport in newest] == [False, False]


def test_where_all_are_being_answered_a_new_one_is_refused(doorway):
    door = doorway(max_connections=2)
    busy = [door.open("192.0.2.2", WHOLE_HEAD) for _ in range(2)]
    refused = door.open("192.0.2.3")
    assert refused.closed
    assert refused.written.startswith(b"HTTP/1.1 503 ")
    assert b'"code":"too-many-connections"' in refused.written
    assert not any(transport.closed for transport in busy)


@pytest.mark.parametrize(
    ("address", "neighbour", "bounded"),
    [
        ("192.0.2.2", "192.0.2.2", True),
        ("192.0.2.2", "192.0.2.3", False),
        ("2001:db8::2", "2001:db8::beef", True),
        ("2001:db8::2", "2001:db8:0:1::2", False),
        ("::ffff:192.0.2.2", "192.0.2.2", True),
        ("127.0.0.1", "127.0.0.1", False),
        ("::1", "::1", False),
    ],
)
def test_an_address_has_a_bound_of_its_own(doorway, address, neighbour, bounded):
    door = doorway(max_connections_per_address=2)
    first = [door.open(address, WHOLE_HEAD) for _ in range(2)]
    assert not any(transport.closed for transport in first)
    assert door.open(neighbour).closed == bounded


def test_a_trusted_proxy_brings_everybody_s_connections(doorway):
    door = doorway(max_connections_per_address=1, trusted_proxies=["192.0.2.0/24"])
    assert not any(door.open("192.0.2.2", WHOLE_HEAD).closed for _ in range(3))
    assert [door.open("198.51.100.2", WHOLE_HEAD).closed for _ in range(2)] == [False, True]


def test_a_head_that_is_too_large_is_refused_though_it_comes_at_once(doorway):
    head = b"GET / HTTP/1.1\r\n" + b"a: b\r\n" * 10_000 + b"\r\n"
    transport = doorway().open("192.0.2.2", head)
    assert transport.closed
    assert transport.written.startswith(b"HTTP/1.1 431 ")
    head, _, body = transport.written.partition(b"\r\n\r\n")
    assert f"x-request-id: {json.loads(body)['request_id']}".encode() in head


def test_networks_are_those_of_subscribers():
    assert network_of("fe80::1%eth0") == "fe80::/64"
    assert network_of("unix socket of a proxy") == "unix socket of a proxy"


def test_more_connections_than_open_files_are_refused_at_the_start(monkeypatch):
    monkeypatch.setattr("resource.getrlimit", lambda _: (1024, 4096))
    with pytest.raises(ListenError, match=r"10000 connections need 20256 open files.*allows 4096.*at most 1920"):
        open_files_for(10_000)


def test_the_limit_of_open_files_is_raised_where_the_system_allows_it(monkeypatch):
    raised = []
    monkeypatch.setattr("resource.getrlimit", lambda _: (1024, 4096))
    monkeypatch.setattr("resource.setrlimit", lambda _, limits: raised.append(limits))
    open_files_for(100)
    open_files_for(1000)
    assert raised == [(2256, 4096)]
