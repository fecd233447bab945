"""The process of one attempt at a job, and the template of such processes.

A package that owns kinds of jobs calls `main` with their work, once it has imported that. An attempt then reports that
it is ready, waits for its assignment, runs it within its limits (`limits`), with its own files alone (`confinement`),
and ends (`protocol`); a template forks attempts that begin there (`forking`).
"""

import os
import shutil
import socket
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import structlog

from sawmill_platform.attempts import protocol
from sawmill_platform.attempts.failures import failure_of
from sawmill_platform.attempts.forking import REQUESTS, TBB, serve
from sawmill_platform.attempts.limits import keep_to, limits_of, peak_memory_bytes
from sawmill_platform.attempts.threading_layer import load
from sawmill_platform.confinement.confinement import confine_to, installation, move_into
from sawmill_platform.contracts.attempts import JobFailure
from sawmill_platform.contracts.jobs import Failure, FailureKind, JobKind
from sawmill_platform.errors import FolderUnavailable, InvalidOutput
from sawmill_platform.files.file_store import flush_tree, work_of
from sawmill_platform.workers.logs import about_attempt, configure_logs
from sawmill_platform.workers.settings import ExecutionSettings
from sawmill_vocabulary import Progress

# Share of the progress after which the result is written: gigabytes, on a slow disk, take minutes.
STORED_FROM = 0.95


def main(work: protocol.Work[Any]) -> None:
    """Run one attempt, or none if the supervisor ends first; as a template, fork one attempt for each request."""
    settings = ExecutionSettings()
    configure_logs(settings.log_format)
    attempt = partial(_attempt, work=work, settings=settings)
    installation()
    if REQUESTS in os.environ:
        load(Path(os.environ[TBB]))
        work.warm_up()
        serve(socket.socket(fileno=int(os.environ[REQUESTS])), attempt)
    else:
        with open(int(os.environ[protocol.CHANNEL]), "wb", buffering=0) as channel:  # noqa: PTH123 - a descriptor, not a path
            work.warm_up()
            attempt(channel)


def _attempt(channel: BinaryIO, work: protocol.Work[Any], settings: ExecutionSettings) -> None:
    """Wait for the assignment on standard input, run it, and send the answer."""
    supervisor = open(0, "rb", buffering=0, closefd=False)  # noqa: SIM115 - lives as long as the process
    try:
        channel.write(protocol.to_line(protocol.Ready()))
    except BrokenPipeError:  # the supervisor was killed in the mean time
        return
    line = b""
    while not line.endswith(b"\n") and (part := supervisor.read(65_536)):
        line += part
    if line.endswith(b"\n"):  # otherwise the supervisor stopped sending
        assignment = protocol.Assignment.model_validate_json(line)
        with about_attempt(assignment.job):
            attempt = _attempt_at(assignment, work, channel)
            answer, error = _answer(
                _gone_files_are_outages(attempt)(
                    partial(_run, attempt, work, settings, supervisor, channel, assignment.answer)
                ),
                assignment.job.kind,
            )
            # Before logging: a log that cannot be written must not lose the answer.
            channel.write(protocol.to_line(answer.model_copy(update={"peak_memory_bytes": peak_memory_bytes()})))
            log = structlog.get_logger()
            if error is not None:
                log.error("job-failed-unexpectedly", exc_info=error)
            elif isinstance(answer, protocol.Failed):
                log.info("job-failed", code=answer.failure.code, detail=answer.failure.detail)


def _end_with(supervisor: BinaryIO) -> None:
    supervisor.read()
    os._exit(1)


def _answer(
    run: Callable[[], dict[str, object]], kind: JobKind
) -> tuple[protocol.Succeeded | protocol.Failed, Exception | None]:
    """Return the attempt's answer, and the exception if it was not foreseen."""
    try:
        return protocol.Succeeded(result=run()), None
    except JobFailure as error:
        return protocol.Failed(failure=Failure(kind=error.kind, code=error.code, detail=error.detail)), None
    except InvalidOutput as error:
        return protocol.Failed(failure=Failure(kind=FailureKind.INTERNAL, code=error.code, detail=str(error))), None
    except MemoryError as error:
        traceback.clear_frames(error.__traceback__)  # they hold what filled the memory, and an answer takes some
        return protocol.Failed(failure=failure_of(error, kind)), None
    except Exception as error:  # noqa: BLE001 - `_log` logs it once the answer is out
        failure = failure_of(error, kind)
        return protocol.Failed(failure=failure), error if failure.kind is FailureKind.INTERNAL else None


@contextmanager
def _gone_files_are_outages(attempt: protocol.Attempt[Any]) -> Iterator[None]:
    """Raise `FolderUnavailable` if the block failed because a file of the attempt was not in its place.

    The kind of exception that a library raised does not matter. The supervisor looks later, when a data folder that was
    away may be back.
    """
    try:
        yield
    except Exception as error:
        ours = [str(path) for path in (attempt.output, *attempt.given.readable)]
        cause: BaseException | None = error
        while cause is not None:
            if isinstance(cause, FileNotFoundError) and any(path in str(cause) for path in ours):
                msg = "the data folder was away, or lacks a file of the job's: the attempt was given up; look at "
                raise FolderUnavailable(f"{msg}its disk or mount in the system's log") from error
            cause = cause.__cause__ or cause.__context__
        raise


def _attempt_at(assignment: protocol.Assignment, work: protocol.Work[Any], channel: BinaryIO) -> protocol.Attempt[Any]:
    def report(progress: Progress) -> None:
        channel.write(
            protocol.to_line(
                protocol.ProgressMade(progress=replace(progress, fraction=STORED_FROM * progress.fraction))
            )
        )

    def announce(names: Sequence[str]) -> None:
        channel.write(protocol.to_line(protocol.Kept(names=list(names))))

    attempt: protocol.Attempt[Any] = work.attempt(
        assignment.job, assignment.given_json, assignment.output, report, announce
    )
    return attempt


def _run(
    attempt: protocol.Attempt[Any],
    work: protocol.Work[Any],
    settings: ExecutionSettings,
    supervisor: BinaryIO,
    channel: BinaryIO,
    to_check: dict[str, Any] | None,
) -> dict[str, object]:
    # Not earlier: the process was started before its job was known.
    limits = limits_of(
        attempt.job.kind, **work.needs_of(attempt)._asdict(), memory_limit_bytes=settings.memory_limit_bytes
    )
    keep_to(limits)
    if to_check is None:
        work.make_ready(attempt)
    move_into(work_of(attempt.output))
    if settings.confine_attempts:
        confine_to(attempt.given, attempt.output)
    # Not earlier: the function confines the threads that are started from then on.
    threading.Thread(target=_end_with, args=(supervisor,), daemon=True).start()
    channel.write(protocol.to_line(protocol.Begun(data_bytes=limits.data_bytes, file_bytes=limits.file_bytes)))
    if to_check is not None:
        work.check(attempt, to_check)
        return {}
    result = work.run(attempt)
    os.chdir(attempt.output)
    # The supervisor may be taking checkpoints; none is needed any more, and none of these files is a result.
    for folder in (attempt.checkpoints, work_of(attempt.output)):
        shutil.rmtree(folder, ignore_errors=True)
    attempt.report(Progress(fraction=1.0, stage="store"))
    flush_tree(attempt.output)
    return result
