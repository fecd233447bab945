"""Output of a command: answers on standard output, all other text on standard error."""
# ruff: noqa: PLC0415 - rich, contracts and science are imported only when they are needed

import json
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING

import typer

from sawmill_vocabulary import Progress, ProgressCallback

if TYPE_CHECKING:
    from sawmill_platform.contracts.jobs import Failure


def say(sentence: str, *, trouble: str | None = None) -> None:
    """Write one line for the person at the terminal, after the highlighted name of a trouble if one is given."""
    from rich.console import Console
    from rich.text import Text

    text = Text(sentence) if trouble is None else Text.assemble((f"{trouble}: ", "bold red"), sentence)
    Console(stderr=True).print(text, soft_wrap=True)


def print_json(document: object) -> None:
    """Print the object of `--json`."""
    sys.stdout.write(json.dumps(document, allow_nan=False) + "\n")


@contextmanager
def answering(*, as_json: bool = False) -> Iterator[None]:
    """End with exit code 1 and one sentence (with `--json` one object) if no answer can be computed.

    The object names the kind of a defect, and a defect keeps its traceback. SIGTERM ends the work as Ctrl-C does:
    half-written files are removed, and the exit code is 143.
    """
    from sawmill_calibration.failures import input_errors_translated
    from sawmill_platform.contracts.attempts import JobFailure
    from sawmill_platform.contracts.jobs import Failure, FailureKind

    try:
        with ending_when_terminated(), input_errors_translated():
            yield
    except JobFailure as failure:
        _report_failure(Failure(kind=failure.kind, code=failure.code, detail=failure.detail), as_json=as_json)
        raise typer.Exit(1) from failure
    except OSError as error:
        _report_failure(Failure(kind=FailureKind.PASSING, code="file-system", detail=str(error)), as_json=as_json)
        raise typer.Exit(1) from error
    except MemoryError as error:
        detail = "this needs more memory than there is: ask for fewer rows, fewer views or a smaller size"
        _report_failure(Failure(kind=FailureKind.INPUT, code="out-of-memory", detail=detail), as_json=as_json)
        raise typer.Exit(1) from error
    except Exception as error:
        detail = f"an unexpected {type(error).__name__}, which is a defect of this program"
        _report_failure(Failure(kind=FailureKind.INTERNAL, code="internal-error", detail=detail), as_json=as_json)
        raise


@contextmanager
def ending_when_terminated() -> Iterator[None]:
    """End at SIGTERM as at Ctrl-C: half-written files are removed, and the exit code is 143."""

    def end(number: int, _frame: FrameType | None) -> None:
        _ended_by.append(number)
        _end_if_asked()

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
        _ended_by.clear()


# Received signals that end the work. An exception of a signal handler is lost if the handler interrupts a callback of
# the interpreter, for example while kernels are loaded: then the next report of progress ends the work.
_ended_by: list[int] = []


def _end_if_asked() -> None:
    if _ended_by:
        raise SystemExit(128 + _ended_by[0])


def _report_failure(failure: "Failure", *, as_json: bool) -> None:
    if as_json:
        print_json({"state": "failed", "failure": failure.model_dump(mode="json")})
    say(failure.detail, trouble=failure.code)


@contextmanager
def showing_progress(what: str) -> Iterator[ProgressCallback]:
    """Show a progress bar if standard error is a terminal; yield the callback that moves the bar."""
    if sys.stderr is None or not sys.stderr.isatty():
        yield lambda _progress: _end_if_asked()
        return
    from sawmill_worker.commands.progress_bar import progress_bar

    with progress_bar(what) as show:

        def report(progress: Progress) -> None:
            _end_if_asked()
            show(progress)

        yield report
