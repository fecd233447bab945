"""Embedded worker processes for a service on one machine: started, watched, started again."""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from types import TracebackType
from typing import Self

import structlog

from sawmill_worker.execution.environment import environment_with
from sawmill_worker.execution.settings import ExecutionSettings
from sawmill_worker.storage.settings import StorageSettings

WORKER_COMMAND = (sys.executable, "-m", "sawmill_worker.execution.poller", "--watch-parent")
_LOOK_S = 0.2
_FIRST_BACK_OFF_S = 0.5
_LONGEST_BACK_OFF_S = 30.0
_HEALTHY_S = 60.0


class WorkerSupervisor:
    """Keeps `settings.workers` worker processes running, as a context manager.

    Each one's standard input announces jobs, and ends with this process, however that ends.

    Parameters
    ----------
    storage
        The store that the workers share.
    settings
        How many there are, and how they run jobs.
    command
        Starts one worker.
    """

    def __init__(
        self, storage: StorageSettings, settings: ExecutionSettings, *, command: Sequence[str] = WORKER_COMMAND
    ) -> None:
        environment = environment_with(storage, settings)
        self._workers = [_WatchedWorker(command, environment) for _ in range(settings.workers)]
        # A worker needs its own grace, and then its child's.
        self._patience_s = settings.stop_grace_s + settings.kill_grace_s + 3.0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="worker-supervisor", daemon=True)

    def __enter__(self) -> Self:
        for worker in self._workers:
            worker.start()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()
        for worker in self._workers:
            worker.ask_to_stop()
        deadline = time.monotonic() + self._patience_s
        for worker in self._workers:
            worker.end(max(0.0, deadline - time.monotonic()))

    def wake(self, _job_id: str) -> None:
        """Announce a job to the workers; one that misses it finds the job at its next look."""
        for worker in self._workers:
            worker.wake()

    @property
    def process_ids(self) -> list[int]:
        """Of the workers that run at the moment."""
        return [worker.process.pid for worker in self._workers if worker.process and worker.process.poll() is None]

    def _watch(self) -> None:
        while not self._stop.wait(_LOOK_S):
            for worker in self._workers:
                worker.restart_if_due()


class _WatchedWorker:
    """One place for a worker process, and how patient to be before it is filled again."""

    def __init__(self, command: Sequence[str], environment: dict[str, str]) -> None:
        self._command = tuple(command)
        self._environment = environment
        self._started_at = 0.0
        self._restart_at: float | None = None
        self._back_off_s = 0.0
        self._speaking = threading.Lock()
        self.process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        self._started_at = time.monotonic()
        self._restart_at = None
        # In a session of its own, so that Ctrl-C reaches the service alone, which then stops its workers in order.
        self.process = subprocess.Popen(  # noqa: S603 - our own command
            self._command, stdin=subprocess.PIPE, bufsize=0, stdout=2, start_new_session=True, env=self._environment
        )

    def wake(self) -> None:
        with self._speaking:
            if self.process is None or self.process.stdin is None or self.process.stdin.closed:
                return
            # A worker that hangs and reads nothing must not make a request wait.
            os.set_blocking(self.process.stdin.fileno(), False)
            with suppress(BrokenPipeError):
                self.process.stdin.write(b"\n")

    def restart_if_due(self) -> None:
        if self.process is None or self.process.poll() is None:
            return
        now = time.monotonic()
        if self._restart_at is None:
            healthy = now - self._started_at > _HEALTHY_S
            doubled_s = 0.0 if healthy else 2 * self._back_off_s
            self._back_off_s = min(max(doubled_s, _FIRST_BACK_OFF_S), _LONGEST_BACK_OFF_S)
            self._restart_at = now + self._back_off_s
            structlog.get_logger().error(
                "worker-ended", exit_code=self.process.returncode, restart_in_s=self._back_off_s
            )
            self._hang_up()
        elif now >= self._restart_at:
            self.start()

    def ask_to_stop(self) -> None:
        if self.process is not None and self.process.poll() is None:
            self.process.terminate()

    def end(self, patience_s: float) -> None:
        if self.process is None:
            return
        try:
            self.process.wait(patience_s)
        except subprocess.TimeoutExpired:
            structlog.get_logger().error("worker-killed", after_s=patience_s)
            self.process.kill()
            self.process.wait()
        self._hang_up()

    def _hang_up(self) -> None:
        with self._speaking:
            if self.process is not None and self.process.stdin is not None:
                self.process.stdin.close()
