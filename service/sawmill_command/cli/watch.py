"""`sawmill watch`: flags."""
# ruff: noqa: PLC0415, FBT002 - imports inside the command: its help needs none; flags are booleans with a default

from pathlib import Path
from typing import Annotated

import typer

from sawmill_platform.attempts.importing import importing
from sawmill_worker.commands.command_line import Command
from sawmill_worker.commands.terminal import say, showing_progress

app = typer.Typer()


@app.command(cls=Command)
def watch(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE.toml", help="Which folders, and where the service is (docs/do/watched-folder.md)."
        ),
    ],
    once: Annotated[
        bool, typer.Option("--once", help="End when all that is whole has been read; exit code 1 if anything is left.")
    ] = False,
    check: Annotated[
        bool, typer.Option("--check", help="Say what would be done, and do nothing; exit code 1 if it would fail.")
    ] = False,
) -> None:
    """Watch folders for scanners that can only write files, and bring each scan to the service once."""
    with importing():
        from sawmill_platform.workers.logs import configure_logs
        from sawmill_platform.workers.settings import ExecutionSettings
        from sawmill_platform.workers.variables import WrongVariableError, variables_checked
        from sawmill_worker.watching import command
        from sawmill_worker.watching.settings import WrongFileError

    try:
        with variables_checked():
            configure_logs(ExecutionSettings().log_format)
        if check:
            results = command.check(file)
            for is_well, sentence in results:
                say(sentence, trouble=None if is_well else "wrong")
            raise typer.Exit(0 if all(is_well for is_well, _ in results) else 1)
        is_well = command.watch(file, showing_progress, once=once)
    except (WrongVariableError, WrongFileError) as error:
        raise typer.BadParameter(str(error)) from error
    except command.CannotWatch as error:
        say(str(error), trouble="cannot watch")
        raise typer.Exit(1) from error
    if once and not is_well:
        raise typer.Exit(1)
