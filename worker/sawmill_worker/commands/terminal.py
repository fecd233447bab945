"""A command's line, and its output: answers on standard output, all other text on standard error.

All missing options are named at once, and a misspelt value gets a suggestion.
"""
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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, ClassVar

from typer.core import TyperCommand


@dataclass(frozen=True)
class OneOf:
    """A group of flags of which exactly one must be given."""

    names: tuple[str, ...]
    what: str

    def missing(self, flags: Sequence[str], given: Mapping[str, Any]) -> list[str]:
        """Return what to write if no flag of the group is given; more than one is wrong use."""
        number = sum(name in given for name in self.names)
        if number > 1:
            raise typer.BadParameter(f"give {self.what} as {' or '.join(flags)}: one of them, not both.")
        return [] if number else [f"option {' or '.join(flags)} ({self.what})"]


class Command(TyperCommand):
    """A command that names all missing options in one sentence, and the nearest choice to an unknown value."""

    one_of: ClassVar[OneOf | None] = None
    # Flags that need another flag.
    needs: ClassVar[Mapping[str, str]] = {}

    # Typer's context has no public type.
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401
        """Parse the line; errors in the line are wrong use."""
        if ctx.resilient_parsing:
            return super().parse_args(ctx, args)
        given, _, _ = self.make_parser(ctx).parse_args(list(args))
        given = {name: value for name, value in given.items() if value is not None}
        missing = self._missing(given)
        try:
            rest = super().parse_args(ctx, args)
        except typer.BadParameter as error:
            if error.param not in missing:
                error.message = error.message.removeprefix("Value error, ") + _nearest(ctx, error.param, given)
                raise
            rest = args
        sentences = [_described(ctx, parameter) for parameter in missing]
        if self.one_of is not None:
            flags = [self._parameter(name).get_error_hint() for name in self.one_of.names]
            sentences += self.one_of.missing(flags, given)
        if sentences:
            ctx.fail(f"Missing {_listed(sentences)}.")
        return rest

    def format_help(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401
        """Write the help, with brackets in a parameter's description as text, not as Rich's markup."""
        from rich.markup import escape

        parameters: Sequence[Any] = self.params
        for parameter in parameters:
            parameter.help = escape(parameter.help or "")
        super().format_help(ctx, formatter)

    def _missing(self, given: Mapping[str, Any]) -> list[Any]:
        """Return the parameters that must be given and are not."""
        needed = [self._parameter(needed_name) for name, needed_name in self.needs.items() if name in given]
        always = [parameter for parameter in self.params if parameter.required]
        return [parameter for parameter in always + needed if parameter.name not in given]

    def _parameter(self, name: str) -> Any:  # noqa: ANN401 - Typer's parameter has no public type
        return next(parameter for parameter in self.params if parameter.name == name)


def nearest(text: str, choices: Sequence[str]) -> str:
    """Return a question that suggests the nearest choice; an empty text if no choice is near."""
    matches = get_close_matches(text, choices, n=1)
    return f" Did you mean {matches[0]!r}?" if matches else ""


def _nearest(ctx: Any, parameter: Any, given: Mapping[str, Any]) -> str:  # noqa: ANN401 - Typer's
    values = given.get(parameter.name)
    # The choices are what a shell would complete.
    choices = [item.value for item in parameter.shell_complete(ctx, "")]
    wrong = [value for value in (values if isinstance(values, list) else [values]) if value not in choices]
    return nearest(wrong[0], choices) if wrong and isinstance(wrong[0], str) else ""


def _described(ctx: Any, parameter: Any) -> str:  # noqa: ANN401 - Typer's
    """Describe a parameter by its kind, name, values and description."""
    values = parameter.metavar or parameter.display_type(ctx)
    shown = "" if parameter.param_type_name == "argument" else f" {values}"
    return f"{parameter.param_type_name} {parameter.get_error_hint()}{shown} ({parameter.help.rstrip('.')})"


def _listed(parts: Sequence[str]) -> str:
    """Join parts to a list in words, for example "this, that and another"."""
    *first, last = parts
    return f"{', '.join(first)} and {last}" if first else last


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
