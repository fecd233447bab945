"""Command line that imports a command's module when the command runs, so that a command loads only its libraries."""

import ast
from collections.abc import Iterator, Mapping
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

import typer
from typer.core import TyperCommand, TyperGroup

from sawmill_platform.attempts.importing import importing


class CommandsOnDemand(TyperGroup):
    """Commands by the names of their modules; a module has a Typer application `app` with the command.

    Help and shell completion list the commands with their docstrings, which are read without importing the modules.
    """

    modules: ClassVar[Mapping[str, str]] = {}

    def __init__(self, **settings: Any) -> None:  # noqa: ANN401 - Typer's
        super().__init__(**settings)
        self.commands = _Imported(self.modules)  # type: ignore[assignment] # read only

    # Typer's context has no public type.
    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ANN401, ARG002
        """List the names in their order."""
        return list(self.modules)

    def get_command(self, ctx: Any, cmd_name: str) -> TyperCommand | None:  # noqa: ANN401, ARG002
        """Describe a command for a list of commands."""
        module = self.modules.get(cmd_name)
        return None if module is None else TyperCommand(cmd_name, help=_docstring(module, cmd_name))

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:  # noqa: ANN401
        """Import the command that a line names."""
        name, _, rest = super().resolve_command(ctx, args)
        return name, None if name is None else self.commands[name], rest


class _Imported(Mapping[str, Any]):
    """Commands by name, imported on access."""

    def __init__(self, modules: Mapping[str, str]) -> None:
        self._modules = modules

    def __getitem__(self, name: str) -> Any:  # noqa: ANN401 - Typer's command or group
        with importing():
            module = import_module(self._modules[name])
        return typer.main.get_group(module.app).commands[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._modules)

    def __len__(self) -> int:
        return len(self._modules)


def _docstring(module: str, command: str) -> str | None:
    """Read the docstring of a command's function from its source, if the function has the command's name."""
    spec = find_spec(module)
    assert spec is not None  # noqa: S101 - a module of the product
    assert spec.origin is not None  # noqa: S101
    function = command.replace("-", "_")
    functions = (
        node
        for node in ast.parse(Path(spec.origin).read_bytes()).body
        if isinstance(node, ast.FunctionDef) and node.name.removesuffix("_") == function
    )
    return ast.get_docstring(next(functions))
