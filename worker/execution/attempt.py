"""The fresh process in which one attempt at a job runs: `python -m worker.execution.attempt`.

It imports the science and loads its kernels, says that it is ready, waits for its assignment, runs it and ends
(see `protocol`).
"""

import os
import resource
import threading
from typing import BinaryIO

import structlog

from worker.contracts.jobs import Failure, Progress
from worker.execution.failures import failure_of
from worker.execution.logs import configure_logs
from worker.execution.protocol import CHANNEL, Assignment, Failed, ProgressMade, Ready, Succeeded, to_line
from worker.execution.settings import ExecutionSettings
from worker.storage.files import flush_tree
from worker.storage.settings import StorageSettings
from worker.storage.store import Store
from worker.tasks.failures import JobFailure
from worker.tasks.running import Attempt, run, warm_up


def main() -> None:
    """Run one attempt, or none when the supervisor goes away first."""
    settings = ExecutionSettings()
    configure_logs(settings.log_format)
    if settings.memory_limit_bytes is not None:
        resource.setrlimit(resource.RLIMIT_DATA, (settings.memory_limit_bytes, settings.memory_limit_bytes))
    supervisor = open(0, "rb", buffering=0, closefd=False)  # noqa: SIM115 - lives as long as the process
    with open(int(os.environ[CHANNEL]), "wb", buffering=0) as channel:  # noqa: PTH123 - a descriptor, not a path
        warm_up()
        channel.write(to_line(Ready()))
        line = supervisor.readline()
        if line:
            threading.Thread(target=_end_with, args=(supervisor,), daemon=True).start()
            channel.write(_answer(Assignment.model_validate_json(line), channel))


def _end_with(supervisor: BinaryIO) -> None:
    supervisor.read()
    os._exit(1)


def _answer(assignment: Assignment, channel: BinaryIO) -> bytes:
    log = structlog.get_logger().bind(job=assignment.job.id, attempt=assignment.job.attempt)
    try:
        return to_line(Succeeded(result=_run(assignment, channel)))
    except JobFailure as failure:
        log.info("job-failed", code=failure.code, detail=failure.detail)
        return to_line(Failed(failure=Failure(kind=failure.kind, code=failure.code, detail=failure.detail)))
    except Exception as error:
        log.exception("job-failed-unexpectedly")
        return to_line(Failed(failure=failure_of(error)))


def _run(assignment: Assignment, channel: BinaryIO) -> dict[str, object]:
    def report(progress: Progress) -> None:
        channel.write(to_line(ProgressMade(progress=progress)))

    store = Store(StorageSettings(data_folder=assignment.data_folder, database_url=assignment.database_url))
    result = run(Attempt(job=assignment.job, store=store, output=assignment.output, report=report))
    flush_tree(assignment.output)
    return result


if __name__ == "__main__":
    main()
