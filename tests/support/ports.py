"""Ports for servers that tests start."""

import secrets
import socket
from contextlib import suppress
from pathlib import Path


def free_port() -> int:
    """Below those that the system gives to outgoing connections, one of which may take any other before its server."""
    lowest = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
    while True:
        port = 10_000 + secrets.randbelow(lowest - 10_000)
        with socket.socket() as free, suppress(OSError):
            free.bind(("127.0.0.1", port))
            return port
