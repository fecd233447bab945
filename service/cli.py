"""The `sawmill` entry: serve, demo, openapi, and the commands that need no server.

The one file of service/ that may reach the science.
"""

import os
import tempfile
import threading
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import structlog
import typer
import uvicorn

from service import openapi_document
from service.app import create_app
from service.dependencies import Wake
from service.settings import ServiceSettings
from worker.cli import app as main
from worker.demo import run_demo
from worker.examples import seed_examples
from worker.execution.celery_app import Waker, make_celery
from worker.execution.logs import configure_logs
from worker.execution.settings import ExecutionSettings
from worker.execution.supervise import WorkerSupervisor
from worker.storage.errors import StorageError
from worker.storage.settings import StorageSettings
from worker.storage.store import Store

__all__ = ["main"]

# Open event streams would hold a shutdown for as long as their clients like.
SHUTDOWN_S = 3


def _no_wake(_: str) -> None:
    """Embedded workers look into the database by themselves."""


def _serve_settings(data: Path | None, host: str | None, port: int | None) -> tuple[StorageSettings, ServiceSettings]:
    for name, value in (("DATA_FOLDER", data), ("HOST", host), ("PORT", port)):
        if value is not None:
            os.environ[f"SAWMILL_{name}"] = str(value)
    return StorageSettings(), ServiceSettings()


@main.command()
def serve(
    data: Annotated[
        Path | None, typer.Option(help="Data folder; SAWMILL_DATA_FOLDER or the default otherwise.")
    ] = None,
    host: Annotated[str | None, typer.Option(help="Address to listen on; loopback by default.")] = None,
    port: Annotated[int | None, typer.Option(min=0, max=65535, help="8000 by default; 0 takes a free one.")] = None,
    workers: Annotated[int | None, typer.Option(min=0, help="Embedded workers; 0 leaves the work to others.")] = None,
    examples: Annotated[bool, typer.Option(help="Put example resources into a fresh data folder.")] = True,  # noqa: FBT002
) -> None:
    """Run the API, its workers and the schedule on this machine."""
    storage, settings = _serve_settings(data, host, port)
    execution = ExecutionSettings() if not workers else ExecutionSettings(workers=workers)
    configure_logs(execution.log_format)
    store = Store.open(storage)
    embedded = execution.broker_url is None and workers != 0
    with ExitStack() as stack:
        if embedded:
            stack.enter_context(WorkerSupervisor(storage, execution))
        if examples:
            threading.Thread(target=_seed, args=(store,), name="examples", daemon=True).start()
        api = create_app(settings, store, _waker(execution, storage))
        log = structlog.get_logger()
        log.info("serving", url=f"http://{settings.host}:{settings.port}", data_folder=str(storage.data_folder))
        uvicorn.run(
            api,
            host=settings.host,
            port=settings.port,
            log_config=None,
            access_log=False,
            server_header=False,
            timeout_graceful_shutdown=SHUTDOWN_S,
        )
    store.close()


def _seed(store: Store) -> None:
    try:
        seed_examples(store)
    except (StorageError, OSError):  # the service works without examples; the next start tries again
        structlog.get_logger().exception("examples-failed")


def _waker(execution: ExecutionSettings, storage: StorageSettings) -> Wake:
    return _no_wake if execution.broker_url is None else Waker(make_celery(execution, storage))


@main.command()
def demo(
    output: Annotated[Path, typer.Option(help="Folder for the pictures, the HDF5 files and index.html.")] = Path(
        "demo-output"
    ),
) -> None:
    """Run the whole job over HTTP on simulated data, and on the published scans where they are."""
    raise typer.Exit(run_demo(output))


@main.command()
def openapi(
    folder: Annotated[Path, typer.Option(help="Where openapi.json and requests/ are written.")] = Path("openapi"),
) -> None:
    """Write the OpenAPI document and its example requests."""
    with tempfile.TemporaryDirectory() as temporary:
        store = Store.open(StorageSettings(data_folder=Path(temporary), database_url=None))
        openapi_document.write(create_app(ServiceSettings(), store, _no_wake), folder)
        store.close()


if __name__ == "__main__":
    main()
