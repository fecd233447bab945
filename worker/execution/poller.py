"""The embedded worker: claims jobs from the database by itself, no broker. `python -m worker.execution.poller`."""

import argparse
import signal
import threading
from collections.abc import Sequence

import structlog

from worker.execution.housekeeping import Housekeeping
from worker.execution.logs import configure_logs
from worker.execution.runner import ATTEMPT_COMMAND, Runner
from worker.execution.settings import ExecutionSettings
from worker.storage.errors import StorageUnavailable
from worker.storage.settings import StorageSettings
from worker.storage.store import Store


def run_worker(
    store: Store,
    settings: ExecutionSettings,
    stop: threading.Event,
    *,
    command: Sequence[str] = ATTEMPT_COMMAND,
) -> None:
    """Claim and run jobs until `stop` is set; a job that is running then is finished or given back.

    Raises
    ------
    worker.execution.process.AttemptNotStarted
        No job can be run on this installation.
    """
    runner = Runner(store, settings, stop, command=command)
    housekeeping = Housekeeping(store, settings, stop)
    housekeeping.start()
    try:
        while not stop.is_set():
            try:
                idle = runner.run_next() is None
            except StorageUnavailable:
                structlog.get_logger().exception("claim-put-off")
                idle = True
            if idle:
                stop.wait(settings.poll_s)
    finally:
        stop.set()
        runner.close()
        housekeeping.join()


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one embedded worker, set up by the environment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--watch-parent", action="store_true", help="stop when standard input ends")
    options = parser.parse_args(arguments)
    settings = ExecutionSettings()
    configure_logs(settings.log_format)
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    if options.watch_parent:
        threading.Thread(target=_stop_with_parent, args=(stop,), daemon=True).start()
    store = Store.open(StorageSettings())
    run_worker(store, settings, stop)
    store.close()


def _stop_with_parent(stop: threading.Event) -> None:
    with open(0, "rb", buffering=0, closefd=False) as parent:
        parent.read()
    stop.set()


if __name__ == "__main__":
    main()
