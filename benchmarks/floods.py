"""Floods of connections against a service at its default settings, and what others notice of them.

    python benchmarks/floods.py [--connections 1500] [--only heads silent bodies readers]

Each flood opens its connections from 127.0.0.1 as fast as it can, and sends nothing more on them: half heads, nothing
at all, half bodies, or requests whose answers it does not read. Meanwhile another address asks for the scanners, each
time on a new connection. Counted are the answers that it gets and how long they take, the service's open files and its
memory, and the time until the service has closed the flood's last connection.
"""

import argparse
import contextlib
import os
import socket
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import httpx

from sawmill_worker import demo_client, examples

OTHER_ADDRESS = "127.0.0.2"
PAUSE_S = 0.1
LONGEST_S = 120.0
HOST = b"Host: 127.0.0.1\r\n"


def floods(scanner_id: str) -> dict[str, bytes]:
    """What each kind sends on a connection."""
    upload = f"POST /v1/scans?scanner_id={scanner_id}&data=counts HTTP/1.1\r\n".encode()
    return {
        "heads": b"GET / HTTP/1.1\r\n" + HOST,
        "silent": b"",
        "bodies": upload + HOST + b"Content-Length: 1000000\r\n\r\nhalf",
        # Three answers of 157 kB: more than a socket keeps.
        "readers": (b"GET /openapi.json HTTP/1.1\r\n" + HOST + b"\r\n") * 3,
    }


def opened(port: int, sent: bytes) -> socket.socket:
    """A connection with a small window, on which something was sent."""
    connection = socket.socket()
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    connection.connect(("127.0.0.1", port))
    with contextlib.suppress(OSError):  # it was refused already
        connection.sendall(sent)
    return connection


def open_files(process_id: int) -> int:
    """Of the service."""
    return sum(1 for _ in Path(f"/proc/{process_id}/fd").iterdir())


def memory_mib(process_id: int) -> float:
    """The service's resident memory."""
    pages = int(Path(f"/proc/{process_id}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def measure(name: str, sent: bytes, count: int, port: int, process_id: int, ask: Callable[[], float | None]) -> None:
    """Print one line of the table."""
    before, began, times, most_files, most_mib = open_files(process_id), time.monotonic(), [ask()], 0, 0.0
    connections = [opened(port, sent) for _ in range(count)]
    while time.monotonic() - began < LONGEST_S:
        times.append(ask())
        most_files = max(most_files, open_files(process_id))
        most_mib = max(most_mib, memory_mib(process_id))
        if open_files(process_id) <= before:
            break
        time.sleep(PAUSE_S)
    closed_s = time.monotonic() - began
    answered = [seconds for seconds in times if seconds is not None]
    print(
        f"{name:<8} {closed_s:7.1f} s {len(answered):5d} of {len(times):<5d}"
        f"{statistics.median(answered):8.3f} s {max(answered):7.3f} s {most_files:6d} {most_mib:8.0f} MiB",
        flush=True,
    )
    for connection in connections:
        connection.close()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--connections", type=int, default=1500)
    parser.add_argument("--only", nargs="+", choices=list(floods("")), default=list(floods("")))
    chosen = parser.parse_args()
    with (
        tempfile.TemporaryDirectory(prefix="sawmill-floods-") as name,
        demo_client.running_service(Path(name)) as client,
        httpx.Client(
            base_url=client.base_url,
            transport=httpx.HTTPTransport(local_address=OTHER_ADDRESS),
            headers={"Connection": "close"},
            timeout=LONGEST_S,
        ) as other,
    ):
        spec = {"name": "line", "constants": vars(examples.SCANNER)}
        scanner = demo_client.post(client, "/v1/scanners", json=spec)
        (process_id,) = map(int, Path(f"/proc/self/task/{os.getpid()}/children").read_text().split())

        def ask() -> float | None:
            began = time.monotonic()
            try:
                answer = other.get("/v1/scanners")
            except httpx.TransportError:
                return None
            return time.monotonic() - began if answer.is_success else None

        port = client.base_url.port
        assert port is not None
        print("flood    all closed   others answered     median     longest  files    memory")
        for kind in chosen.only:
            measure(kind, floods(scanner["id"])[kind], chosen.connections, port, process_id, ask)


if __name__ == "__main__":
    main()
