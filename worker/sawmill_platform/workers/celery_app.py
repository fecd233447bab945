"""Celery workers for a cluster: Redis carries wake-ups, and workers claim jobs when they are woken.

A message announces only that there may be a job, not which one is next: it is acknowledged at once, and losing or
repeating it does no harm. A worker serves both lanes, one after the other as messages come. A worker with
`-Q sawmill-short` serves short jobs alone, so that these do not wait for a long job.
"""

import os
import queue
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from types import FrameType
from typing import Any

import structlog
from celery import Celery, signals
from celery.worker import WorkController
from kombu.entity import Queue
from kombu.exceptions import OperationalError
from redis.exceptions import RedisError

from sawmill_platform.attempts.process import AttemptNotStarted
from sawmill_platform.attempts.runner import Runner
from sawmill_platform.confinement import landlock
from sawmill_platform.confinement.confinement import say_if_unconfined
from sawmill_platform.errors import StorageError, StorageFull, StorageUnavailable
from sawmill_platform.job_service_store import JobServiceStore
from sawmill_platform.jobs.wait_estimate import Selection
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.broker_report import report_of
from sawmill_platform.workers.logs import configure_logs
from sawmill_platform.workers.program import WorkerProgram, open_store, say_if_crowded
from sawmill_platform.workers.settings import ExecutionSettings

RUN_JOB = "sawmill.run_job"
_QUEUE = "sawmill"
_SHORT_QUEUE = "sawmill-short"
_LANES = {False: _QUEUE, True: _SHORT_QUEUE}  # queues by whether a job is short
_CONNECT_TIMEOUT_S = 1.0
_ANSWER_TIMEOUT_S = 2.0  # time for an answer of a server that does little but move a few bytes
_HEALTH_CHECK_S = 5.0  # a worker starts to wait for messages again 6 to 11 s after Redis fell silent
_MOST_WAITING = 100  # wake-ups; further ones add nothing
_CLOSE_S = 2.0


def make_celery(settings: ExecutionSettings) -> Celery:
    """Make the Celery application of senders, which workers extend (`serve`).

    Parameters
    ----------
    settings
        Settings that name a broker.

    Raises
    ------
    ValueError
        The settings name no broker.
    """
    if settings.broker_url is None:
        raise ValueError("broker_url must name a Redis server, as in redis://127.0.0.1:6379/0; set SAWMILL_BROKER_URL")
    app = Celery("sawmill", broker=settings.broker_url, set_as_current=False)
    app.conf.update(
        accept_content=["json"],
        task_serializer="json",
        task_default_queue=_QUEUE,
        task_queues=[Queue(name) for name in _LANES.values()],  # type: ignore[no-untyped-call]
        task_ignore_result=True,
        task_acks_late=False,
        task_publish_retry=False,  # the sweep sends lost wake-ups again
        worker_pool="threads",  # each thread supervises a process; forked children and Numba do not go together
        worker_concurrency=settings.workers,
        worker_prefetch_multiplier=1,
        worker_disable_prefetch=True,  # a message that a busy worker holds would keep an idle one waiting
        worker_soft_shutdown_timeout=settings.stop_grace_s + settings.kill_grace_s + _CLOSE_S,
        worker_hijack_root_logger=False,
        broker_connection_retry_on_startup=True,
        broker_connection_max_retries=None,  # a worker outlives any outage of Redis
        broker_transport_options={
            "socket_timeout": _ANSWER_TIMEOUT_S,
            "socket_connect_timeout": _CONNECT_TIMEOUT_S,
            "socket_keepalive": True,
            "connect_retries_timeout": _CONNECT_TIMEOUT_S,
            "health_check_interval": _HEALTH_CHECK_S,
            "interval_start": 0.1,
        },
    )
    return app


def serve(app: Celery, settings: ExecutionSettings, storage: StorageSettings, program: WorkerProgram[Any]) -> Celery:
    """Let an application's workers run jobs.

    Parameters
    ----------
    app, settings
        Application from `make_celery`, and its settings.
    storage
        Settings of the store that all machines share.
    program
        Program of the workers.
    """
    engine = CeleryWorker(app, settings, storage, program)
    app.task(engine.run_job, name=RUN_JOB)
    # The signals are Celery's own and fire in worker processes only.
    signals.worker_init.connect(engine.start, weak=False)
    signals.worker_ready.connect(engine.stop_on_signals, weak=False)
    signals.worker_shutting_down.connect(engine.stop, weak=False)
    signals.worker_shutdown.connect(engine.close, weak=False)
    return app


class Waker:
    """Sender of wake-ups from its own thread, best effort: the caller never waits for Redis.

    Parameters
    ----------
    app
        Application from `make_celery`.
    is_short
        Function that returns whether a job waits in the short lane.
    """

    def __init__(self, app: Celery, is_short: Callable[[str], bool]) -> None:
        self._app = app
        self._is_short = is_short
        self._waiting: queue.Queue[str | None] = queue.Queue(_MOST_WAITING)
        self._given_up = threading.Event()
        self._thread = threading.Thread(target=self._send_until_closed, name="wake-ups", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def __call__(self, job_id: str) -> None:
        """Announce a job soon. A wake-up that Redis does not take is dropped: the sweep sends it again later."""
        try:
            self._waiting.put_nowait(job_id)
        except queue.Full:
            structlog.get_logger().warning("wake-up-dropped", job_id=job_id, reason=f"{_MOST_WAITING} wait to be sent")

    def close(self) -> None:
        """Send the wake-ups that wait, for two seconds at most; the sweep sends the rest."""
        with suppress(queue.Full):  # in that case Redis does not answer, and waiting for it would be in vain
            self._waiting.put_nowait(None)
            self._thread.join(_CLOSE_S)
        self._given_up.set()

    def _send_until_closed(self) -> None:
        while (job_id := self._waiting.get()) is not None and not self._given_up.is_set():
            try:
                short = self._is_short(job_id)
                self._app.send_task(RUN_JOB, args=[job_id, short], queue=_LANES[short])
            except (OperationalError, RedisError, StorageError) as error:
                structlog.get_logger().warning("wake-up-not-sent", job_id=job_id, reason=str(error))
            except Exception:  # noqa: BLE001 - jobs are found by this thread alone: whatever happens, it goes on
                structlog.get_logger().exception("wake-up-not-sent", job_id=job_id)


@dataclass(eq=False)
class CeleryWorker:
    """A Celery worker process while it runs."""

    app: Celery
    settings: ExecutionSettings
    storage: StorageSettings
    program: WorkerProgram[Any]

    def __post_init__(self) -> None:
        self._stop = threading.Event()

    def start(self, sender: WorkController, **_: Any) -> None:  # noqa: ANN401 - Celery's signal arguments
        """Open the store and start everything that runs beside the jobs; raise `SystemExit` if that is impossible."""
        configure_logs(self.settings.log_format)
        pool = str(sender.pool_cls)
        if "prefork" in pool:
            raise SystemExit("use the threads or the solo pool: each job has a process of its own already")
        # No worker listens to messages among workers, and when Redis is silent Celery sends its heartbeat again for
        # ever, in the thread that has to end the worker.
        sender.options |= {"without_heartbeat": True, "without_gossip": True, "without_mingle": True}
        # As many jobs as Celery runs at once, whatever `--concurrency` says.
        self.settings = self.settings.model_copy(update={"workers": 1 if "solo" in pool else int(sender.concurrency)})
        say_if_crowded(self.settings)
        say_if_unconfined(self.settings, os.geteuid(), landlock.version())
        # Celery handles signals later, and the first process of a container receives no signal that it does not handle.
        before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
        try:
            store: JobServiceStore | None = open_store(partial(self.program.open_store, self.storage), self._stop)
        except (StorageError, OSError) as error:  # Celery would log the error and continue without a store
            raise SystemExit(f"this worker cannot start: {error}") from error
        finally:
            signal.signal(signal.SIGTERM, before)
        assert store is not None  # noqa: S101 - nothing has set `stop` yet
        self._store = store
        self._wake = Waker(self.app, self._store.jobs.is_short)
        attempts = self.program.attempts(self._store, self.settings)
        self._runner = Runner(self._store, self.settings, self._stop, attempts=attempts, on_ended=self._wake_waiting)
        self._runner.warm_up()
        self._housekeeping = self.program.housekeeping(self._store, self.settings, self._stop)
        self._housekeeping.start()
        self._wake.start()
        # Apart from the housekeeping, which continues whatever Redis does.
        sweep = (self._stop, self._store, self.app, self.settings, self._wake)
        threading.Thread(target=sweep_until, args=sweep, name="sweep", daemon=True).start()

    def stop_on_signals(self, **_: Any) -> None:  # noqa: ANN401
        """Return jobs to the queue from the first signal on: in a cold shutdown Celery reports it after waiting."""
        for number in (signal.SIGTERM, signal.SIGQUIT):
            signal.signal(number, partial(self._stop_and_handle, signal.getsignal(number)))

    def _stop_and_handle(self, handler: Any, number: int, frame: FrameType | None) -> None:  # noqa: ANN401
        if not self._stop.is_set():  # the interrupted thread may be setting the event
            self._stop.set()
        handler(number, frame)

    def stop(self, **_: Any) -> None:  # noqa: ANN401
        """Return running jobs to the queue."""
        self._stop.set()

    def close(self, **_: Any) -> None:  # noqa: ANN401
        """End everything that `start` has started."""
        self._stop.set()
        self._runner.close()
        self._housekeeping.join()
        self._wake.close()
        self._store.close()

    def run_job(self, _job_id: str, short: bool | None = None) -> None:  # noqa: FBT001 - Celery's argument
        """Run the next job in turn in a lane: the database decides on the order, not the messages."""
        try:
            self._runner.run_next(Selection(short=short))
        except (StorageFull, StorageUnavailable) as error:
            self._runner.log_put_off(error)
            return
        except (AttemptNotStarted, OSError) as error:  # no job was claimed: the sweep announces it again
            structlog.get_logger().error("attempt-not-started", reason=str(error))
            return
        self._runner.warm_up()

    def _wake_waiting(self, job_id: str) -> None:
        for waiting in self._store.jobs.waiting_for(job_id):
            self._wake(waiting)


def sweep_until(
    stop: threading.Event, store: JobServiceStore, app: Celery, settings: ExecutionSettings, wake: Callable[[str], None]
) -> None:
    """Send lost wake-ups again until an event is set, one look every `housekeeping_s`; an outage is logged once."""
    trouble: str | None = None
    while not stop.wait(settings.housekeeping_s):
        before, trouble = trouble, report_of(str(settings.broker_url)).trouble
        if trouble is not None:
            if trouble != before:
                structlog.get_logger().warning("sweep-put-off", reason=trouble)
            continue
        try:
            _sweep(store, app, settings, wake)
        except (OperationalError, RedisError, StorageError) as error:
            structlog.get_logger().warning("sweep-put-off", reason=str(error))
        except Exception:  # noqa: BLE001 - lost wake-ups are found by this thread alone: whatever happens, it goes on
            structlog.get_logger().exception("sweep-put-off")


def _sweep(store: JobServiceStore, app: Celery, settings: ExecutionSettings, wake: Callable[[str], None]) -> None:
    """Send the wake-ups of waiting jobs again if no message of their lane is on its way: they cannot pile up."""
    for short, name in _LANES.items():
        lost = store.jobs.queued_job_ids(older_than_s=settings.sweep_s, short=short, limit=_MOST_WAITING // len(_LANES))
        if lost:
            with app.connection_for_write() as connection:
                on_the_way = connection.default_channel.queue_declare(queue=name, durable=True).message_count
            if on_the_way == 0:
                for job_id in lost:
                    wake(job_id)
