"""Option for the data folder, for commands that work on the service's data, and the settings from the option."""
# ruff: noqa: PLC0415 - imports inside functions: a command loads only its libraries

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from sawmill_platform.settings import StorageSettings

Data = Annotated[Path | None, typer.Option(help="Data folder; SAWMILL_DATA_FOLDER or the default otherwise.")]


def settings_of(data: Path | None) -> "StorageSettings":
    """Return the settings of a data folder; None selects the environment's folder. The caller checks the variables."""
    from sawmill_platform.settings import StorageSettings

    return StorageSettings() if data is None else StorageSettings(data_folder=data)


@contextmanager
def wrong_variables_refused() -> Iterator[None]:
    """Make a wrong environment variable wrong use of a command."""
    from sawmill_platform.workers.settings import WrongVariableError, variables_checked

    try:
        with variables_checked():
            yield
    except WrongVariableError as error:
        raise typer.BadParameter(str(error)) from error


def storage_settings(data: Path | None) -> "StorageSettings":
    """Return the settings of a data folder for a command."""
    with wrong_variables_refused():
        return settings_of(data)
