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

    What libraries warn of is shaped in the same way, unless somebody else, as Celery, has seen to it. Tracebacks come
    without local variables, which hold requests' headers and other people's data.
    """
    stream = cast("TextIO", _BestEffort(sys.stderr))  # nobody asks for more of a file than that has
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
    """Name the job, its attempt and who asked for it in every line that this thread logs inside the block."""
    asked_by = {name: value for name in ("request_id", "key_id") if (value := getattr(job, name)) is not None}
    with structlog.contextvars.bound_contextvars(job_id=job.id, attempt=job.attempt, kind=job.kind, **asked_by):
        yield


@contextmanager
def going_on(event: str, *, said: set[str] | None = None, **details: object) -> Iterator[None]:
    """Log whatever the block raises, an outage in one line, and go on: for a thread that nobody would start again.

    Parameters
    ----------
    event
        Its name in the log.
    said
        The caller's, of outages that need no further line; this one is put in.
    details
        Beside the reason.
    """
    try:
        yield
    except Exception as error:  # noqa: BLE001 - the next round comes whatever happens in this one
        with suppress(Exception):  # out of memory, say: then there is nothing left to say it with
            outage = outage_of(error, "the work") if isinstance(error, OSError) else error
            if isinstance(outage, StorageFull | StorageUnavailable):
                if said is None or str(outage) not in said:
                    structlog.get_logger().warning(event, reason=str(outage), **details)
                if said is not None:
                    said.add(str(outage))
            else:
                structlog.get_logger().exception(event, **details)


class _BestEffort:
    """A log's stream: what a full disk or a reader that is gone does not take is lost, and nothing else is."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> None:
        with suppress(OSError):
            self._stream.write(text)

    def flush(self) -> None:
        with suppress(OSError):
            self._stream.flush()
