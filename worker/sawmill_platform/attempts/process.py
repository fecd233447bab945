"""The supervisor's end of the process in which an attempt runs."""

import os
import select
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from fcntl import F_SETPIPE_SZ, fcntl
from pathlib import Path
from typing import IO, Protocol

import structlog
from pydantic import ValidationError

from sawmill_platform.attempts import protocol

# Time from SIGKILL until a process that still runs is given up.
UNDYING_S = 10.0
# Capacity of a pipe by default.
PIPE_BYTES = 2**16


class AttemptNotStarted(Exception):  # noqa: N818 - an outcome's name
    """A process did not become ready: the installation is broken, and no job is at fault."""


class AttemptTalksNonsense(Exception):  # noqa: N818
    """A process sent a line that is not of the protocol: nothing more that it sends is trusted."""


class Running(Protocol):
    """A process that was started, with the interface of `subprocess.Popen`."""

    @property
    def stdin(self) -> IO[bytes] | None:
        """Stream to the process's standard input."""

    @property
    def pid(self) -> int | None:
        """Process id; None if the id is not known yet."""

    def poll(self) -> int | None:
        """Return the process's exit code, or None while it runs."""

    def wait(self, timeout: float | None = None) -> int:
        """Wait until the process has ended and return its exit code."""


class AttemptProcess:
    """A process in its own session, so that the process and all its children can be ended at once."""

    def __init__(
        self, process: Running, channel: int, template_id: int | None = None, *, undying_s: float = UNDYING_S
    ) -> None:
        self._process = process
        self._undying_s = undying_s
        self._template_id = template_id
        self._channel = open(channel, "rb", buffering=0)  # noqa: SIM115 - a descriptor, closed by `end`
        self._unread = bytearray()
        self._ready = self._answered = False
        self.hung_up = False

    @property
    def alive(self) -> bool:
        """True if the process still runs."""
        return self._process.poll() is None

    def wait_until_ready(self, timeout_s: float) -> None:
        """Wait until the process has imported everything, while it uses processor time: first imports take minutes."""
        importing = self._template_id or self._process.pid
        deadline, used_s = time.monotonic() + timeout_s, processor_s_of(importing)
        while not self._ready:
            left_s = deadline - time.monotonic()
            if left_s <= 0:
                before_s, used_s = used_s, processor_s_of(importing)
                if used_s == before_s:
                    raise AttemptNotStarted(f"a process stood still for {timeout_s:g} s before it was ready")
                deadline, left_s = time.monotonic() + timeout_s, timeout_s
            for message in self.receive(left_s):
                if isinstance(message, protocol.Ready):
                    self._ready = True
            if self.hung_up:
                raise AttemptNotStarted(f"a process ended with exit code {self._process.wait()} before it was ready")

    def assign(self, assignment: protocol.Assignment) -> None:
        """Send the attempt's assignment; if the process has died by now, `receive` finds out."""
        if self._process.stdin is None:
            raise AssertionError("standard input is a pipe")
        line = protocol.to_line(assignment)
        with suppress(OSError):  # the process continues without it; but a stopped process must not stop its supervisor
            fcntl(self._process.stdin.fileno(), F_SETPIPE_SZ, max(len(line), PIPE_BYTES))
        try:
            self._process.stdin.write(line)
        except BrokenPipeError:
            self.hung_up = True

    @property
    def process_id(self) -> int | None:
        """Process id; None if the process has ended, or the id is not known yet."""
        return self._process.pid if self.alive else None

    def receive(self, timeout_s: float) -> list[protocol.AnyMessage]:
        """Return the messages that arrive within a time; none if no message arrives, or the process `hung_up`."""
        waiting = select.poll()
        waiting.register(self._channel, select.POLLIN)
        if not waiting.poll(timeout_s * 1000):
            return []
        data = self._channel.read(65_536)
        self.hung_up = not data
        self._unread += data
        if len(self._unread) > protocol.LONGEST_LINE_BYTES:
            raise AttemptTalksNonsense(f"a line of more than {protocol.LONGEST_LINE_BYTES} bytes")
        if b"\n" not in data:
            return []
        *lines, self._unread = self._unread.split(b"\n")
        try:
            # PostgreSQL stores no text with a NUL, which a stranger's file may have put into a sentence.
            messages = [protocol.MESSAGE.validate_json(line.replace(rb"\u0000", rb"\ufffd")) for line in lines]
        except ValidationError as error:
            raise AttemptTalksNonsense(str(error)) from error
        for line, message in zip(lines, messages, strict=True):
            if len(line) > protocol.LONGEST_SENTENCE_BYTES and not isinstance(message, protocol.Succeeded):
                raise AttemptTalksNonsense(f"{len(line)} bytes of {message.kind!r}")
            self._answered |= isinstance(message, protocol.Succeeded | protocol.Failed)
        return messages

    def end(self, grace_s: float) -> int:
        """End the process and all that it started: first by a request, after `grace_s` by a kill.

        A process that has answered ends by itself, as soon as it has logged why a job failed: no request is sent.

        A process that the system does not end, for example while it waits for a disk that is away, is left to end
        later: nobody waits for it, and no other attempt uses its folder.
        """
        if not self.hung_up and not self._answered:  # otherwise it is ending by itself; its exit code is the reason
            self._signal(signal.SIGTERM)
        try:
            self._process.wait(grace_s)
        except subprocess.TimeoutExpired:
            self._signal(signal.SIGKILL)
        try:
            code = self._process.wait(self._undying_s)
        except subprocess.TimeoutExpired:
            structlog.get_logger().error("attempt-not-ended", process=self._process.pid, after_s=self._undying_s)
            code = -signal.SIGKILL
        if self._process.stdin is not None:
            self._process.stdin.close()
        self._channel.close()
        return code

    def _signal(self, number: signal.Signals) -> None:
        # Only while the process is unreaped is its group's number certain to be its own.
        if self._process.poll() is None and self._process.pid is not None:
            with suppress(ProcessLookupError):  # forked this moment, it leads no group yet: SIGKILL follows
                os.killpg(self._process.pid, number)


def processor_s_of(process_id: int | None) -> float:
    """Return the processor time that a process has used (proc(5)), seconds; 0 if the process has ended."""
    with suppress(FileNotFoundError, ProcessLookupError):
        stat = Path(f"/proc/{process_id}/stat").read_text()
        return sum(map(int, stat.rpartition(")")[2].split()[11:13])) / os.sysconf("SC_CLK_TCK")
    return 0.0


class AttemptStarter(Protocol):
    """A starter of the processes in which attempts run; threads may share a starter."""

    def start(self) -> AttemptProcess:
        """Start a process that becomes ready soon; raise `OSError` if the system starts none now."""

    def patience_s(self, start_timeout_s: float) -> float:
        """Return the time that a process may take until it is ready."""

    def close(self) -> None:
        """End what the starter holds besides its processes; a later start begins again."""


class FreshProcesses:
    """Starter of attempts, each in a process that imports everything itself."""

    def __init__(self, command: Sequence[str], environment: Mapping[str, str]) -> None:
        self._command = tuple(command)
        self._environment = environment

    def start(self) -> AttemptProcess:
        """Start a process that becomes ready soon."""
        reading, writing = os.pipe()
        try:
            process = subprocess.Popen(  # noqa: S603 - our own command
                self._command,
                stdin=subprocess.PIPE,
                bufsize=0,
                stdout=2,  # what libraries print must not mix with a command's JSON
                pass_fds=[writing],
                start_new_session=True,
                env={**self._environment, protocol.CHANNEL: str(writing)},
            )
        except OSError:
            os.close(reading)
            raise
        finally:
            os.close(writing)
        return AttemptProcess(process, reading)

    def patience_s(self, start_timeout_s: float) -> float:
        """Return the time that a process may take until it is ready."""
        return start_timeout_s

    def close(self) -> None:
        """Do nothing: besides its processes a starter holds no resources."""
