"""Structured logs on standard error."""

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Literal, TextIO, cast

import structlog

from sawmill_platform.contracts.jobs import Job
from sawmill_platform.errors import StorageFull, StorageUnavailable, outage_of


def configure_logs(log_format: Literal["console", "json"]) -> None:
    """Send this process's log to standard error, for people or as one JSON object a line.

    Warnings of libraries get the same form, unless another package, such as Celery, has configured them. Tracebacks do
    not show local variables, which contain requests' headers and other people's data.
    """
    stream = cast("TextIO", _BestEffort(sys.stderr))  # these methods of a file are the only ones that are used
    common: list[structlog.typing.Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.processors.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
    ]
    rendering = _rendering(log_format)
    structlog.configure(processors=[*common, *rendering], logger_factory=structlog.WriteLoggerFactory(stream))
    foreign = logging.StreamHandler(stream)
    without_record = structlog.stdlib.ProcessorFormatter.remove_processors_meta
    foreign.setFormatter(
        structlog.stdlib.ProcessorFormatter(processors=[without_record, *rendering], foreign_pre_chain=common)
    )
    logging.basicConfig(handlers=[foreign])


def _rendering(log_format: Literal["console", "json"]) -> list[structlog.typing.Processor]:
    if log_format == "json":
        as_dict = structlog.processors.ExceptionRenderer(
            structlog.tracebacks.ExceptionDictTransformer(show_locals=False)
        )
        return [as_dict, structlog.processors.JSONRenderer()]
    plain = structlog.dev.plain_traceback
    return [structlog.dev.ConsoleRenderer(colors=sys.stderr.isatty(), exception_formatter=plain)]


@contextmanager
def about_attempt(job: Job) -> Iterator[None]:
    """Add the job, its attempt and its client to every line that this thread logs inside the block."""
    asked_by = {name: value for name in ("request_id", "key_id") if (value := getattr(job, name)) is not None}
    with structlog.contextvars.bound_contextvars(job_id=job.id, attempt=job.attempt, kind=job.kind, **asked_by):
        yield


@contextmanager
def going_on(event: str, *, said: set[str] | None = None, **details: object) -> Iterator[None]:
    """Log an exception of the block, an outage in one line, and continue: for a thread that nobody would restart.

    Parameters
    ----------
    event
        Name of the event in the log.
    said
        The caller's set of outages that need no further line; this outage is added.
    details
        Further values for the line, besides the reason.
    """
    try:
        yield
    except Exception as error:  # noqa: BLE001 - the next round comes whatever happens in this one
        with suppress(Exception):  # for example out of memory: then there is no memory left to log it
            outage = outage_of(error, "the work") if isinstance(error, OSError) else error
            if isinstance(outage, StorageFull | StorageUnavailable):
                if said is None or str(outage) not in said:
                    structlog.get_logger().warning(event, reason=str(outage), **details)
                if said is not None:
                    said.add(str(outage))
            else:
                structlog.get_logger().exception(event, **details)


class _BestEffort:
    """Stream of a log: lines that a full disk or a closed reader does not take are lost, without an exception."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> None:
        with suppress(OSError):
            self._stream.write(text)

    def flush(self) -> None:
        with suppress(OSError):
            self._stream.flush()
