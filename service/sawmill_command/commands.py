"""List of the commands of `sawmill`; a command is imported when it runs (`sawmill_command/cli/on_demand.py`)."""
# ruff: noqa: FBT002 - a flag is a boolean with a default

from typing import Annotated, ClassVar

import typer

from sawmill_command.cli.on_demand import CommandsOnDemand
from sawmill_vocabulary.version import VERSION


class SawmillCommands(CommandsOnDemand):
    """Commands that need no server, and commands of the service."""

    modules: ClassVar = {
        name: f"sawmill_command.cli.{name}"
        for name in (
            "inspect",
            "calibrate",
            "report",
            "repeatability",
            "drift",
            "reconstruct",
            "simulate",
            "pack",
            "export",
            "worker",
            "compile",
            "phantom",
        )
    } | {
        "budget": "sawmill_command.cli.report",
        "image-quality": "sawmill_command.cli.reconstruct",
        "calibrate-pairs": "sawmill_command.cli.calibrate_pairs",
        "locate-marks": "sawmill_command.cli.calibrate_pairs",
        "audit": "sawmill_command.key_commands",
        "key": "sawmill_command.key_commands",
        "backup": "sawmill_command.backup_commands",
        "restore": "sawmill_command.backup_commands",
        "copy-to-postgresql": "sawmill_command.backup_commands",
        "serve": "sawmill_command.server_commands",
        "migrate": "sawmill_command.server_commands",
        "doctor": "sawmill_command.server_commands",
        "install-service": "sawmill_command.server_commands",
        "demo": "sawmill_command.server_commands",
        "openapi": "sawmill_command.server_commands",
    }


main = typer.Typer(cls=SawmillCommands, no_args_is_help=True, pretty_exceptions_show_locals=False)


def _print_version(asked: bool) -> None:  # noqa: FBT001 - Typer's callback
    if asked:
        typer.echo(VERSION)
        raise typer.Exit


@main.callback()
def sawmill(
    _version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Geometry calibration and reconstruction for sawmill X-ray log scanners."""


if __name__ == "__main__":
    main()
