"""The option of commands that work on the service's data, and the settings that follow from it."""
# ruff: noqa: PLC0415 - imports inside: none of the commands waits for another's libraries

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from sawmill_platform.settings import StorageSettings

Data = Annotated[Path | None, typer.Option(help="Data folder; SAWMILL_DATA_FOLDER or the default otherwise.")]


def settings_of(data: Path | None) -> "StorageSettings":
    """Of a data folder; null: that of the environment. Whoever calls checks the variables."""
    from sawmill_platform.settings import StorageSettings

    return StorageSettings() if data is None else StorageSettings(data_folder=data)


def storage_settings(data: Path | None) -> "StorageSettings":
    """The same for a command; a wrong variable is wrong use."""
    from sawmill_platform.workers.variables import WrongVariableError, variables_checked

    try:
        with variables_checked():
            return settings_of(data)
    except WrongVariableError as error:
        raise typer.BadParameter(str(error)) from error
