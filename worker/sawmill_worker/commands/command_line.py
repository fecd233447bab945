"""Parsing of a command line: all missing options are named at once, and a misspelt value gets a suggestion."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, ClassVar

import typer
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
        from rich.markup import escape  # noqa: PLC0415 - only help needs it

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
