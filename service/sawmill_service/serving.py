"""The API, its workers and the schedule on one machine, which run until the process is stopped."""

import logging
import signal
import threading
from collections.abc import Callable
from contextlib import ExitStack, closing
from functools import partial
from types import FrameType

import structlog
import uvicorn

from sawmill_platform.attempts.importing import PROGRAM
from sawmill_platform.errors import StorageError
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.logs import configure_logs
from sawmill_platform.workers.program import open_store
from sawmill_platform.workers.settings import ExecutionSettings
from sawmill_platform.workers.sole_service import ClockKeeper, refuse_second, sole_service
from sawmill_platform.workers.supervise import WorkerSupervisor
from sawmill_service.app import create_app
from sawmill_service.dependencies import Wake
from sawmill_service.http.bodies.sent_content import UnreadBodies
from sawmill_service.http.listening import ListenError, RefusedAccepts, connections_of, is_loopback, listen
from sawmill_service.http.responses.drawn import return_freed_memory
from sawmill_service.settings import ServiceSettings
from sawmill_service.stopping import Server, ServiceManager
from sawmill_service.webhooks.destinations import AllowedDestinations
from sawmill_service.webhooks.sender import WebhookSender
from sawmill_store.store import Store

# The process of a worker, which alone imports the science.
WORKER_COMMAND = (*PROGRAM, "sawmill_worker.poller", "--watch-parent")
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
# An idle connection ends after this time without another request. A connection that never had a request does not end.
_IDLE_S = 5
# Limit of an incomplete head of a request or of a chunk. Complete heads: `admission.py`.
_HEAD_BYTES = 2**14
# More would keep the requests of open connections waiting while a flood of new ones is accepted.
_ACCEPTED_AT_ONCE = 64

BEHIND_A_PROXY = (
    "SAWMILL_PUBLIC_URL or SAWMILL_TRUSTED_PROXIES means that requests come through a proxy, so each must bring a key: "
    "make one with sawmill key create --name NAME --scope admin, or set SAWMILL_TOKEN (at least 32 characters)"
)
WITHOUT_A_PROXY = (
    "other machines reach the service without a proxy: nothing encrypts keys and scans on the line (TLS), and nothing "
    "ends connections of slow clients; put Caddy or nginx in front, as examples/proxy/ has it, and declare it with "
    "SAWMILL_PUBLIC_URL and SAWMILL_TRUSTED_PROXIES"
)


def no_wake(_: str) -> None:
    """Do nothing: embedded workers poll the database by themselves."""


def serve_until_stopped(
    settings: ServiceSettings,
    storage: StorageSettings,
    execution: ExecutionSettings,
    *,
    workers: bool,
    seed: Callable[[Store], None] | None,
) -> None:
    """Listen for requests; run workers too, unless a broker carries jobs to other processes or `workers` is false.

    Parameters
    ----------
    seed
        Fills a fresh data folder with examples while the service already answers.

    Raises
    ------
    StorageError, OSError
        The data folder cannot be used, or another process serves it.
    ListenError
        The address or the port cannot be used.
    """
    configure_logs(execution.log_format)
    logging.getLogger("asyncio").addFilter(RefusedAccepts())
    return_freed_memory()
    for number in _SIGNALS:
        signal.signal(number, _end_start)
    with ExitStack() as stack:
        refuse_second(storage)
        guarded = settings.token is not None or (settings.may_be_reached and _has_key(storage))
        listening = stack.enter_context(closing(listen(settings.host, settings.port, guarded=guarded)))
        if settings.behind_proxy and not guarded:
            raise ListenError(BEHIND_A_PROXY)
        stack.enter_context(sole_service(storage))
        store = stack.enter_context(closing(_opened(storage)))
        stack.enter_context(store.files.receiving())
        stack.enter_context(ClockKeeper(store))
        stack.enter_context(WebhookSender(store.outbox(), AllowedDestinations(settings.webhook_destinations)))
        wake: Wake = no_wake
        if execution.broker_url is not None:
            # Imported here: Celery's 11 MiB are not needed without a broker.
            from sawmill_platform.workers.celery_app import Waker, make_celery  # noqa: PLC0415

            waker = stack.enter_context(closing(Waker(make_celery(execution), store.jobs.is_short)))
            waker.start()
            wake = waker
        elif workers:
            supervisor = WorkerSupervisor(storage, execution, WORKER_COMMAND, held_up=store.jobs.short_job_is_held_up)
            wake = stack.enter_context(supervisor).wake
        if seed is not None:
            threading.Thread(target=_seed, args=(seed, store), name="examples", daemon=True).start()
        address, port = listening.getsockname()[:2]
        if not is_loopback(address) and not settings.behind_proxy:
            structlog.get_logger().warning("no-proxy", reason=WITHOUT_A_PROXY)
        app = create_app(settings, store, wake, exposed=not is_loopback(address), broker_url=execution.broker_url)
        config = uvicorn.Config(
            UnreadBodies(app),
            http="h11",
            ws="none",
            limit_concurrency=connections_of(settings.max_connections),
            backlog=_ACCEPTED_AT_ONCE,
            timeout_keep_alive=_IDLE_S,
            h11_max_incomplete_event_size=_HEAD_BYTES,
            log_config=None,
            access_log=False,
            server_header=False,
            proxy_headers=False,
        )
        structlog.get_logger().info(
            "serving", url=f"http://{settings.host}:{port}", data_folder=str(storage.data_folder)
        )
        Server(config, app.state.stopping, ServiceManager()).run(sockets=[listening])
        _ignore_signals()


def _has_key(storage: StorageSettings) -> bool:
    """Return whether any key is valid; a store that does not exist yet has none."""
    if storage.database_url is None and not (storage.data_folder / "sawmill.db").exists():
        return False
    with closing(_opened(storage)) as store:
        return store.keys.any_good()


def _end_start(_number: int, _frame: FrameType | None) -> None:
    """End in order what has started; while uvicorn runs, it handles the signals."""
    _ignore_signals()
    raise SystemExit(0)


def _ignore_signals() -> None:
    """Ignore further signals: the service already ends, and they would only cut that short."""
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def _opened(storage: StorageSettings) -> Store:
    """Open the store, however long that takes: connected clients wait, and a signal ends the process."""
    store = open_store(partial(Store.open, storage), threading.Event())
    assert store is not None  # noqa: S101 - nobody sets the event
    return store


def _seed(seed: Callable[[Store], None], store: Store) -> None:
    try:
        seed(store)
    except (StorageError, OSError):  # the service works without examples; the next start tries again
        structlog.get_logger().exception("examples-failed")
