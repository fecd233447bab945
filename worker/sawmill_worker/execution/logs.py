"""Structured logs on standard error."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Literal, TextIO, cast

import structlog


def configure_logs(log_format: Literal["console", "json"]) -> None:
    """Send this process's log to standard error, for people or as one JSON object a line.

    Tracebacks come without local variables, which hold requests' headers and other people's data.
    """
    processors: list[structlog.typing.Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.processors.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
    ]
    if log_format == "json":
        as_dict = structlog.processors.ExceptionRenderer(
            structlog.tracebacks.ExceptionDictTransformer(show_locals=False)
        )
        processors += [as_dict, structlog.processors.JSONRenderer()]
    else:
        plain = structlog.dev.plain_traceback
        processors.append(structlog.dev.ConsoleRenderer(colors=sys.stderr.isatty(), exception_formatter=plain))
    # The factory asks for no more of a file than `_BestEffort` has.
    factory = structlog.WriteLoggerFactory(cast("TextIO", _BestEffort(sys.stderr)))
    structlog.configure(processors=processors, logger_factory=factory)


@contextmanager
def going_on(event: str, **details: object) -> Iterator[None]:
    """Log whatever the block raises, and go on: for a thread that nobody would start again."""
    try:
        yield
    except Exception:  # noqa: BLE001 - the next round comes whatever happens in this one
        with suppress(Exception):  # out of memory, say: then there is nothing left to say it with
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
