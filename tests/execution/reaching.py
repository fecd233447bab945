"""What somebody would try who got hold of an attempt's process, and how each try ends."""

import os
import socket
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path


def tries(output: Path) -> Iterator[tuple[str, Callable[[], object]]]:
    """Each with its name; the data folder and what lies beside it are found from the attempt's own folder."""
    data = output.parents[1]
    canary, worker = data.parent / "canary", os.getppid()
    yield "read a file beside the data folder", canary.read_bytes
    yield "read the database", (data / "sawmill.db").read_bytes
    yield "read another upload", (data / "uploads" / "scans" / "other" / "original").read_bytes
    yield "read the settings of the worker", Path(f"/proc/{worker}/environ").read_bytes
    yield "read the memory of the worker", Path(f"/proc/{worker}/mem").read_bytes
    yield "read who has accounts", Path("/etc/passwd").read_bytes
    yield "list the data folder", lambda: list(data.iterdir())
    yield "list everything", lambda: list(Path("/").iterdir())
    yield "write beside the data folder", lambda: canary.write_text("changed")
    yield "write into the database", lambda: (data / "sawmill.db").write_bytes(b"")
    yield "cut the canary short", lambda: os.truncate(canary, 0)
    yield "write among results", lambda: (data / "scans" / "mine").write_text("made up")
    yield "make a folder among results", (data / "scans" / "mine").mkdir
    yield "remove the canary", canary.unlink
    yield "link out of its own folder", lambda: (output / "scan.h5").symlink_to(canary)
    yield "make a pipe in its own folder", lambda: os.mkfifo(output / "pipe")
    yield "run a program", lambda: subprocess.run(["/bin/true"], check=True)
    yield "call the service", lambda: socket.create_connection(("127.0.0.1", 9), timeout=1)
    yield "listen", lambda: socket.create_server(("127.0.0.1", 0))
    yield "send a datagram", lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM).sendto(b"x", ("127.0.0.1", 9))
    yield "call a local server", lambda: socket.socket(socket.AF_UNIX).connect("/run/postgresql/.s.PGSQL.5432")
    yield "change a mode", lambda: canary.chmod(0o777)
    yield "change a time", lambda: os.utime(canary)
    yield "send the worker a signal", lambda: os.kill(worker, 0)


def endings(output: Path) -> dict[str, str]:
    """The outcome of each try: an error's name, or `done`."""
    found = {}
    for name, attempt in tries(output):
        try:
            attempt()
            found[name] = "done"
        except OSError as error:
            found[name] = type(error).__name__
    return found
