"""A supervisor's end of the process in which an attempt runs."""

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

from sawmill_platform.attempts.protocol import (
    CHANNEL,
    LONGEST_LINE_BYTES,
    LONGEST_SENTENCE_BYTES,
    MESSAGE,
    AnyMessage,
    Assignment,
    Ready,
    Succeeded,
    to_line,
)

# From SIGKILL until a process that still runs is given up.
UNDYING_S = 10.0
# What a pipe holds by default.
PIPE_BYTES = 2**16


class AttemptNotStarted(Exception):  # noqa: N818 - an outcome's name
    """A process did not become ready: the installation is broken, no job is to blame."""


class AttemptTalksNonsense(Exception):  # noqa: N818
    """What a process sends is not of the protocol: nothing that it sends is believed any more."""


class Running(Protocol):
    """A process that was started, as `subprocess.Popen` shows it."""

    @property
    def stdin(self) -> IO[bytes] | None:
        """Leads to its standard input."""

    @property
    def pid(self) -> int | None:
        """None where it is not known yet."""

    def poll(self) -> int | None:
        """Its exit code, or None."""

    def wait(self, timeout: float | None = None) -> int:
        """Its exit code, once it has ended."""


class AttemptProcess:
    """A process in a session of its own, so that all of it can be ended at once.

    Parameters
    ----------
    process
        Speaks `protocol`.
    channel
        Descriptor from which its messages are read; closed by `end`.
    template_id
        The process that forks it once it has imported everything; null: it does that itself.
    """

    def __init__(self, process: Running, channel: int, template_id: int | None = None) -> None:
        self._process = process
        self._template_id = template_id
        self._channel = open(channel, "rb", buffering=0)  # noqa: SIM115 - a descriptor, closed by `end`
        self._unread = bytearray()
        self._ready = False
        self.hung_up = False

    @property
    def alive(self) -> bool:
        """Whether it still runs."""
        return self._process.poll() is None

    def wait_until_ready(self, timeout_s: float) -> None:
        """Wait until it has imported everything, as long as it works at that: the first import compiles for minutes.

        Raises
        ------
        AttemptNotStarted
            It ended, or used no processor time for `timeout_s`.
        """
        deadline, ticks = time.monotonic() + timeout_s, self._processor_ticks()
        while not self._ready:
            left_s = deadline - time.monotonic()
            if left_s <= 0:
                before, ticks = ticks, self._processor_ticks()
                if ticks == before:
                    raise AttemptNotStarted(f"a process stood still for {timeout_s:g} s before it was ready")
                deadline, left_s = time.monotonic() + timeout_s, timeout_s
            for message in self.receive(left_s):
                if isinstance(message, Ready):
                    self._ready = True
            if self.hung_up:
                raise AttemptNotStarted(f"a process ended with exit code {self._process.wait()} before it was ready")

    def _processor_ticks(self) -> int:
        """Processor time that whoever imports has used, in ticks of the kernel (proc(5)); 0: it has ended."""
        with suppress(FileNotFoundError, ProcessLookupError):
            stat = Path(f"/proc/{self._template_id or self._process.pid}/stat").read_text()
            return sum(map(int, stat.rpartition(")")[2].split()[11:13]))
        return 0

    def assign(self, assignment: Assignment) -> None:
        """Hand over the one attempt; `receive` finds out where the process has died by now."""
        if self._process.stdin is None:
            raise AssertionError("standard input is a pipe")
        line = to_line(assignment)
        with suppress(OSError):  # it reads by itself; but one that is stopped must not stop its supervisor
            fcntl(self._process.stdin.fileno(), F_SETPIPE_SZ, max(len(line), PIPE_BYTES))
        try:
            self._process.stdin.write(line)
        except BrokenPipeError:
            self.hung_up = True

    @property
    def process_id(self) -> int | None:
        """None where it has ended, or is not known yet."""
        return self._process.pid if self.alive else None

    def receive(self, timeout_s: float) -> list[AnyMessage]:
        """Messages that arrive within a time; none when there are none, or when it `hung_up`.

        Raises
        ------
        AttemptTalksNonsense
            A line is not of the protocol, or has no end.
        """
        waiting = select.poll()
        waiting.register(self._channel, select.POLLIN)
        if not waiting.poll(timeout_s * 1000):
            return []
        data = self._channel.read(65_536)
        self.hung_up = not data
        self._unread += data
        if len(self._unread) > LONGEST_LINE_BYTES:
            raise AttemptTalksNonsense(f"a line of more than {LONGEST_LINE_BYTES} bytes")
        if b"\n" not in data:
            return []
        *lines, self._unread = self._unread.split(b"\n")
        try:
            # PostgreSQL keeps no text with a NUL, which a stranger's file may have put into a sentence.
            messages = [MESSAGE.validate_json(line.replace(rb"\u0000", rb"\ufffd")) for line in lines]
        except ValidationError as error:
            raise AttemptTalksNonsense(str(error)) from error
        for line, message in zip(lines, messages, strict=True):
            if len(line) > LONGEST_SENTENCE_BYTES and not isinstance(message, Succeeded):
                raise AttemptTalksNonsense(f"{len(line)} bytes of {message.kind!r}")
        return messages

    def end(self, grace_s: float) -> int:
        """End it and all it started: asked first, killed after `grace_s`.

        One that the system itself does not let end, as while it waits for a disk that is away, is left to end when that
        lets it: nobody waits for it, and its folder is its own.

        Returns
        -------
        int
            Exit code; negative is a signal's number.
        """
        if not self.hung_up:  # else it is ending by itself, and its exit code is the reason
            self._signal(signal.SIGTERM)
        try:
            self._process.wait(grace_s)
        except subprocess.TimeoutExpired:
            self._signal(signal.SIGKILL)
        try:
            code = self._process.wait(UNDYING_S)
        except subprocess.TimeoutExpired:
            structlog.get_logger().error("attempt-not-ended", process=self._process.pid, after_s=UNDYING_S)
            code = -signal.SIGKILL
        if self._process.stdin is not None:
            self._process.stdin.close()
        self._channel.close()
        return code

    def _signal(self, number: signal.Signals) -> None:
        # Only while it is unreaped is its process group's number surely its own.
        if self._process.poll() is None and self._process.pid is not None:
            with suppress(ProcessLookupError):  # forked this moment, it leads no group yet: SIGKILL follows
                os.killpg(self._process.pid, number)


class FreshProcesses:
    """Starts each attempt in a process of its own from the beginning.

    Parameters
    ----------
    command
        Starts a program that speaks `protocol`.
    environment
        Its environment variables.
    """

    def __init__(self, command: Sequence[str], environment: Mapping[str, str]) -> None:
        self._command = tuple(command)
        self._environment = environment

    def start(self) -> AttemptProcess:
        """A process that becomes ready soon."""
        reading, writing = os.pipe()
        try:
            process = subprocess.Popen(  # noqa: S603 - our own command
                self._command,
                stdin=subprocess.PIPE,
                bufsize=0,
                stdout=2,  # what libraries print must not mix with a command's JSON
                pass_fds=[writing],
                start_new_session=True,
                env={**self._environment, CHANNEL: str(writing)},
            )
        except OSError:
            os.close(reading)
            raise
        finally:
            os.close(writing)
        return AttemptProcess(process, reading)

    def patience_s(self, start_timeout_s: float) -> float:
        """How long a process may take until it is ready."""
        return start_timeout_s

    def close(self) -> None:
        """Nothing is left beside the processes."""
