"""Embedded worker processes for a service on one machine: start, supervision and restart."""

import os
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Self

import structlog

from sawmill_platform.confinement import landlock
from sawmill_platform.confinement.confinement import say_if_unconfined
from sawmill_platform.errors import StorageUnavailable
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.logs import going_on
from sawmill_platform.workers.program import environment_with, say_if_crowded
from sawmill_platform.workers.settings import ExecutionSettings

_LOOK_S = 0.2
_LANE_LOOK_S = 1.0  # period of checks for a short job that nobody announced, such as one that waited for another job
_FIRST_BACK_OFF_S = 0.5
_LONGEST_BACK_OFF_S = 30.0


class WorkerSupervisor:
    """Supervisor of `settings.workers` worker processes, as a context manager, and of one more while it is needed.

    The additional process is the short lane: it takes short jobs only, is started while long jobs keep all other
    workers busy, and ends by itself after a minute without a job. It uses all cores too: the system divides them.

    Each worker's standard input announces jobs, and ends with this process, however it ends. A worker that was able to
    run jobs is replaced at once; one that never was is replaced after longer and longer waits.

    Parameters
    ----------
    storage
        Settings of the store that the workers share.
    settings
        Settings with the number of workers, and of the execution of jobs.
    command
        Command of one worker, with `--short` for the short lane.
    held_up
        Function that returns whether a short job waits while this number of workers are busy with long jobs; null:
        there is no short lane.
    """

    def __init__(
        self,
        storage: StorageSettings,
        settings: ExecutionSettings,
        command: Sequence[str],
        *,
        held_up: Callable[[int], bool] | None = None,
    ) -> None:
        self._settings = settings
        environment = environment_with(storage, settings)
        general = [WatchedWorker(command, environment) for _ in range(settings.workers)]
        alone = environment_with(storage, settings.model_copy(update={"workers": 1}))
        self._short = WatchedWorker([*command, "--short"], alone)
        self._general, self._workers = general, [*general, self._short]
        self._held_up = held_up
        self._look_at = 0.0
        # A worker needs its own grace time, and then its child's.
        self._patience_s = settings.stop_grace_s + settings.kill_grace_s + 3.0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="worker-supervisor", daemon=True)

    def __enter__(self) -> Self:
        say_if_crowded(self._settings)
        say_if_unconfined(self._settings, os.geteuid(), landlock.version())
        for worker in self._general:
            worker.start()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        for worker in self._workers:
            worker.ask_to_stop()
        deadline = time.monotonic() + self._patience_s
        for worker in self._workers:
            worker.end(max(0.0, deadline - time.monotonic()))

    def wake(self, _job_id: str) -> None:
        """Announce a job to the workers; a worker that misses it finds the job at its next look."""
        self._look_at = 0.0
        for worker in self._workers:
            worker.wake()

    def _watch(self) -> None:
        while not self._stop.wait(_LOOK_S):
            for worker in self._general:
                with going_on("worker-not-watched"):
                    worker.restart_if_due()
            with going_on("short-lane-not-watched"):
                self._open_short_lane()

    def _open_short_lane(self) -> None:
        if self._held_up is None or self._short.is_running or time.monotonic() < self._look_at:
            return
        self._look_at = time.monotonic() + _LANE_LOOK_S
        try:
            needed = self._held_up(self._settings.workers)
        except StorageUnavailable as error:
            structlog.get_logger().warning("look-put-off", reason=str(error))
            return
        if needed:
            self._short.start_if_due()


class WatchedWorker:
    """A slot for a worker process, with the wait before it is filled again.

    A socket is the process's standard input: bytes to the process announce jobs, one byte from it reports that it can
    run jobs.
    """

    def __init__(
        self, command: Sequence[str], environment: dict[str, str], *, monotonic: Callable[[], float] = time.monotonic
    ) -> None:
        self._monotonic = monotonic
        self._command = tuple(command)
        self._environment = environment
        self._restart_at: float | None = None
        self._back_off_s = 0.0
        self._speaking = threading.Lock()
        self._line: socket.socket | None = None
        self.process: subprocess.Popen[bytes] | None = None  # that was started last

    @property
    def is_running(self) -> bool:
        """True if the process runs."""
        return self.process is not None and self.process.poll() is None

    def start(self) -> None:
        """Start the process; if the system does not start it now, the start is retried as after its end."""
        self._restart_at = None
        ours, theirs = socket.socketpair()
        try:
            with theirs:
                # In its own session, so that Ctrl-C reaches the service alone, which then stops the process in order.
                self.process = subprocess.Popen(  # noqa: S603 - our own command
                    self._command, stdin=theirs.fileno(), stdout=2, start_new_session=True, env=self._environment
                )
        except BaseException as error:
            ours.close()
            if not isinstance(error, OSError):
                raise
            self._put_off("worker-not-started", reason=str(error))
            return
        ours.settimeout(0.0)  # a worker that hangs and does not read must not make a request wait
        with self._speaking:
            self._line = ours

    def wake(self) -> None:
        """Announce a job to the process, without waiting."""
        with self._speaking, suppress(OSError):  # the socket is full of announcements, or the worker has ended
            if self._line is not None:
                self._line.send(b"\n")

    def restart_if_due(self) -> None:
        """Start an ended process again, after a wait that begins when its end is seen."""
        if self.is_running:
            return
        if self._restart_at is None:
            if self._has_worked():
                self._back_off_s = 0.0
            self._hang_up()
            self._put_off("worker-ended", exit_code=self.process and self.process.returncode)
        elif self._monotonic() >= self._restart_at:
            self.start()

    def start_if_due(self) -> None:
        """Start a process that ends by itself when no longer needed."""
        if self._restart_at is None and (self.process is None or self.process.poll() == 0):
            self._hang_up()
            self._back_off_s = 0.0
            self.start()
        else:
            self.restart_if_due()

    def ask_to_stop(self) -> None:
        """Request the end of the process."""
        if self.process is not None and self.is_running:
            self.process.terminate()

    def end(self, patience_s: float) -> None:
        """Wait for the end of the process, and kill it if that does not come in time."""
        if self.process is not None:
            try:
                self.process.wait(patience_s)
            except subprocess.TimeoutExpired:
                structlog.get_logger().error("worker-killed", after_s=patience_s)
                self.process.kill()
                self.process.wait()
        self._hang_up()

    def _has_worked(self) -> bool:
        """Return whether the ended process reported that it could run jobs."""
        try:
            return self._line is not None and bool(self._line.recv(1))
        except OSError:
            return False

    def _put_off(self, event: str, **details: object) -> None:
        """Delay the next start: the wait doubles from the last time until a worker has been able to run jobs."""
        self._back_off_s = min(max(2 * self._back_off_s, _FIRST_BACK_OFF_S), _LONGEST_BACK_OFF_S)
        self._restart_at = self._monotonic() + self._back_off_s
        structlog.get_logger().error(event, restart_in_s=self._back_off_s, **details)

    def _hang_up(self) -> None:
        with self._speaking:
            if self._line is not None:
                self._line.close()
                self._line = None
