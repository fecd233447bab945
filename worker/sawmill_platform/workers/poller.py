"""The embedded worker: claims jobs from the database, no broker."""

import math
import os
import signal
import threading
import time
from collections.abc import Callable, Collection
from contextlib import closing, suppress
from functools import partial

from sawmill_platform.attempts.process import AttemptNotStarted
from sawmill_platform.attempts.runner import Runner
from sawmill_platform.contracts.jobs import JobKind
from sawmill_platform.errors import StorageError, StorageFull, StorageUnavailable
from sawmill_platform.jobs.wait_estimate import ANY, Selection
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.logs import configure_logs
from sawmill_platform.workers.program import S, WorkerProgram, open_store
from sawmill_platform.workers.settings import ExecutionSettings

# Idle time of the short lane: its memory is worth keeping while somebody works with short jobs, and no longer.
SHORT_IDLE_S = 60.0


def run_worker(
    program: WorkerProgram[S],
    store: S,
    settings: ExecutionSettings,
    stop: threading.Event,
    *,
    wake: threading.Event | None = None,
    on_able: Callable[[], None] = lambda: None,
    selection: Selection = ANY,
    idle_s: float = math.inf,
) -> None:
    """Claim and run jobs until `stop` is set; a job that is running then is finished or returned to the queue."""
    wake = wake or threading.Event()
    runner = Runner(store, settings, stop, attempts=program.attempts(store, settings), on_able=on_able)
    housekeeping = program.housekeeping(store, settings, stop)
    housekeeping.start()
    worked_at = time.monotonic()
    try:
        while not stop.is_set() and (idle_for_s := time.monotonic() - worked_at) < idle_s:
            wake.clear()
            resting = idle_for_s >= settings.spare_idle_s
            try:
                idle = (resting and not store.jobs.could_start(selection)) or runner.run_next(selection) is None
            except (StorageFull, StorageUnavailable, AttemptNotStarted, OSError) as error:
                if isinstance(error, AttemptNotStarted) and not runner.able:
                    raise
                runner.log_put_off(error)
                wake.wait(settings.outage_wait_s)
                continue
            if idle:
                if resting:
                    runner.close()
                else:
                    runner.warm_up()
                wake.wait(settings.poll_s)
            else:
                worked_at = time.monotonic()
    finally:
        stop.set()
        runner.close()
        housekeeping.join()


def run(
    program: WorkerProgram[S],
    *,
    watch_parent: bool = False,
    short_only: bool = False,
    kinds: Collection[str] = (),
    groups: Callable[[S], Collection[str]] = lambda _: (),
) -> None:
    """Run one embedded worker, configured by the environment.

    Parameters
    ----------
    program
        Program of the worker.
    watch_parent
        Look for a job at each byte on standard input, and stop at its end.
    short_only
        Take short jobs only, and end after `SHORT_IDLE_S` without any.
    kinds
        Take jobs of these kinds only; empty: of all kinds.
    groups
        Function from the store to the ids of the groups whose jobs are taken; empty: all jobs, also without a group.

    Raises
    ------
    SystemExit
        The worker cannot start; the message is one sentence.
    """
    settings = ExecutionSettings()
    configure_logs(settings.log_format)
    stop, wake = threading.Event(), threading.Event()
    _end_on_signals(stop, wake)
    if watch_parent:
        threading.Thread(target=listen_to_parent, args=(stop, wake), daemon=True).start()
    try:
        store = open_store(partial(program.open_store, StorageSettings()), stop)
        if store is not None:
            with closing(store):
                run_worker(
                    program,
                    store,
                    settings,
                    stop,
                    wake=wake,
                    on_able=report_to_parent if watch_parent else lambda: None,
                    selection=Selection(
                        short=True if short_only else None,
                        kinds=frozenset(kind for kind in JobKind.all() if kind in kinds) or None,
                        group_ids=frozenset(groups(store)) or None,
                    ),
                    idle_s=SHORT_IDLE_S if short_only else math.inf,
                )
    except (StorageError, AttemptNotStarted, OSError) as error:
        raise SystemExit(f"this worker cannot start: {error}") from error


def report_to_parent() -> None:
    """Report to the parent process (`supervise`) that this worker can run jobs: a byte on standard input, a socket."""
    with suppress(OSError):  # the parent is gone: `listen_to_parent` handles that
        os.write(0, b"\n")


def _end_on_signals(stop: threading.Event, wake: threading.Event) -> None:
    """Set both events at the first signal to stop.

    A thread does so: a signal handler may interrupt the holder of an event's lock.
    """
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    signal.set_wakeup_fd(writing)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: None)

    def listen() -> None:
        os.read(reading, 1)
        stop.set()
        wake.set()

    threading.Thread(target=listen, daemon=True).start()


def listen_to_parent(stop: threading.Event, wake: threading.Event) -> None:
    """Look for a job at each byte on standard input, and stop at its end; the function returns then."""
    # A parent that is killed before it has read this worker's report resets the connection instead of closing it.
    with suppress(ConnectionResetError), open(0, "rb", buffering=0, closefd=False) as parent:
        while parent.read(1024):
            wake.set()
    stop.set()
    wake.set()
