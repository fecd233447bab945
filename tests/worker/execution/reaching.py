"""What somebody would try who got hold of an attempt's process, and how each try ends."""

import ctypes
import os
import resource
import socket
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

IO_URING_SETUP, SET_DUMPABLE = 425, 4


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
    yield "limit the worker", lambda: resource.prlimit(worker, resource.RLIMIT_CPU)
    yield "slow the worker down", lambda: os.setpriority(os.PRIO_PROCESS, worker, 19)
    yield "keep the worker to one core", lambda: os.sched_setaffinity(worker, {min(os.sched_getaffinity(0))})
    yield "have a process", os.fork
    yield "have a process that shares the memory", lambda: os.posix_spawn("/bin/true", ["true"], {})
    yield "leave its session", os.setsid
    yield "leave its process group", lambda: os.setpgid(0, 0)
    yield "make a pair of sockets", socket.socketpair
    yield "send by a descriptor", lambda: called("sendto", 1, b"x", 1, 0, None, 0)
    yield "send a message by a descriptor", lambda: called("sendmsg", 1, None, 0)
    yield "send messages by a descriptor", lambda: called("sendmmsg", 1, None, 0, 0)
    yield "let the kernel work through a ring", lambda: called("syscall", IO_URING_SETUP, 1, None)
    yield "have memory that nobody counts", lambda: os.memfd_create("memory")
    yield "hide its descriptors", lambda: called("prctl", SET_DUMPABLE, 0, 0, 0, 0)
    yield "rename the machine", lambda: socket.sethostname(socket.gethostname())
    yield "have another root", lambda: os.chroot("/")


def called(name: str, *arguments: int | bytes | None) -> None:
    """Call a function of the C library that returns a negative number where it fails."""
    if getattr(ctypes.CDLL(None, use_errno=True), name)(*arguments) < 0:
        raise OSError(ctypes.get_errno(), name)


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
