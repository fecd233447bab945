"""The supervisor's end of the template (module `forking`) and of the children that it forks."""

import os
import select
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from sawmill_platform.attempts.forking import REQUESTS, TBB, WARM
from sawmill_platform.attempts.process import AttemptProcess
from sawmill_platform.attempts.threading_layer import LAYER, tbb_library

# A warm template forks within milliseconds; one that has not forked by now is stopped or hangs.
FORK_TIMEOUT_S = 10.0
# Time from a child's end until the template has entered its exit code.
BOOK_TIMEOUT_S = 2.0
UNKNOWN_END = -signal.SIGKILL
NOT_FORKED = 1


class Template:
    """Starter of attempts as children of a process that has imported everything; threads may share a starter.

    A template that has ended is replaced at the next start. Its children outlive it.

    Parameters
    ----------
    command
        Command of a program that serves `forking` if its environment requests that.
    environment
        Environment variables of the program.
    tbb
        Path of TBB's library.
    fork_timeout_s
        Time after which a warm template that has not forked is given up.
    book_timeout_s
        Time for which the exit code of an ended child is waited for.
    """

    def __init__(
        self,
        command: Sequence[str],
        environment: Mapping[str, str],
        tbb: Path,
        *,
        fork_timeout_s: float = FORK_TIMEOUT_S,
        book_timeout_s: float = BOOK_TIMEOUT_S,
    ) -> None:
        self._fork_timeout_s = fork_timeout_s
        self._book_timeout_s = book_timeout_s
        self._command = tuple(command)
        self._environment = {**environment, LAYER: "tbb", TBB: str(tbb)}
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._requests: socket.socket | None = None
        self._warm = False

    @property
    def process_id(self) -> int | None:
        """Id of the template's process; None if there is none at the moment."""
        process = self._process
        return None if process is None else process.pid

    def start(self) -> AttemptProcess:
        """Request a child without waiting for the answer."""
        with self._lock:
            requests = self._running()
            (assignment_in, assignment), (channel, channel_in), (book, book_in) = [os.pipe() for _ in range(3)]
            try:
                with suppress(BrokenPipeError, ConnectionResetError):  # then it has just died, and the pipes close
                    socket.send_fds(requests, [b"fork"], [assignment_in, channel_in, book_in])
            finally:
                for theirs in (assignment_in, channel_in, book_in):
                    os.close(theirs)
            template_id = self.process_id
        child = ForkedProcess(assignment, book, book_timeout_s=self._book_timeout_s)
        return AttemptProcess(child, channel, template_id)

    def patience_s(self, start_timeout_s: float) -> float:
        """Return the time that a child may take until it is ready: little once the template is warm."""
        with self._lock:
            if self._requests is not None and not self._warm:
                with suppress(BlockingIOError, ConnectionResetError):
                    self._warm = self._requests.recv(len(WARM), socket.MSG_DONTWAIT) == WARM
            return min(self._fork_timeout_s, start_timeout_s) if self._warm else start_timeout_s

    def close(self) -> None:
        """End the template, not its children."""
        with self._lock:
            self._end()

    def _running(self) -> socket.socket:
        if self._requests is not None and self._process is not None and self._process.poll() is None:
            return self._requests
        self._end()
        self._requests, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._requests.set_inheritable(False)
        with theirs:
            self._process = subprocess.Popen(  # noqa: S603 - our own command
                self._command,
                stdin=subprocess.DEVNULL,
                stdout=2,
                pass_fds=[theirs.fileno()],
                start_new_session=True,
                env={**self._environment, REQUESTS: str(theirs.fileno())},
            )
        return self._requests

    def _end(self) -> None:
        self._warm = False
        if self._requests is not None:
            self._requests.close()
            self._requests = None
        if self._process is not None:
            self._process.kill()  # the template holds nothing, and a stopped one receives no other signal
            self._process.wait()
            self._process = None


class ForkedProcess:
    """A child of the template, with the interface of `subprocess.Popen`."""

    def __init__(self, assignment: int, book: int, *, book_timeout_s: float = BOOK_TIMEOUT_S) -> None:
        self._book_timeout_s = book_timeout_s
        self.stdin: BinaryIO = open(assignment, "wb", buffering=0)  # noqa: SIM115 - closed by AttemptProcess
        self.pid: int | None = None
        self._book: BinaryIO = open(book, "rb", buffering=0)  # noqa: SIM115 - closed with its last entry
        self._entries = b""
        self._end = -1
        self._code: int | None = None

    def poll(self) -> int | None:
        """Return the child's exit code; None while it runs, or has not been forked yet."""
        with suppress(subprocess.TimeoutExpired):
            return self.wait(0.0)
        return None

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the child's end; a child that is not forked yet ends by itself, as its standard input is closed."""
        deadline = None if timeout is None else time.monotonic() + timeout
        if self._code is None and self.pid is None:
            entry = self._entry(0.0 if timeout is None else timeout)
            if entry:
                self.pid = int(entry)
                try:
                    self._end = os.pidfd_open(self.pid)
                except ProcessLookupError:
                    self._close(int(self._entry(self._book_timeout_s) or UNKNOWN_END))
            elif entry is not None:
                self._close(NOT_FORKED)
        if self._code is None and self.pid is None and timeout is None:
            self._close(NOT_FORKED)
        if self._code is None:
            left_s = None if deadline is None else max(deadline - time.monotonic(), 0.0)
            if self.pid is None or not _readable(self._end, left_s):
                raise subprocess.TimeoutExpired("attempt", timeout or 0.0)
            self._close(int(self._entry(self._book_timeout_s) or UNKNOWN_END))
        assert self._code is not None  # noqa: S101
        return self._code

    def _entry(self, timeout_s: float) -> bytes | None:
        """Return the book's next line; empty if the book has ended, None if no line came in time."""
        while b"\n" not in self._entries:
            if not _readable(self._book.fileno(), timeout_s):
                return None
            data = self._book.read(64)
            if not data:
                return b""
            self._entries += data
        line, _, self._entries = self._entries.partition(b"\n")
        return line

    def _close(self, code: int) -> None:
        self._code = code
        self._book.close()
        if self._end >= 0:
            os.close(self._end)
            self._end = -1


def _readable(descriptor: int, timeout_s: float | None) -> bool:
    waiting = select.poll()
    waiting.register(descriptor, select.POLLIN)
    return bool(waiting.poll(None if timeout_s is None else timeout_s * 1000))


def template_library() -> Path | None:
    """Return the path of TBB's library if attempts can be forked; None if each has to be a fresh process.

    Numba's other threads do not survive a fork, and a kernel without `pidfd_open` cannot report a child's end.
    """
    try:
        os.close(os.pidfd_open(os.getpid()))
    except (AttributeError, OSError):
        return None
    return tbb_library()
