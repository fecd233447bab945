"""`sawmill backup`, `sawmill restore` and `sawmill copy-to-postgresql`."""
# ruff: noqa: PLC0415, FBT002 - imports inside the commands: a command loads only its libraries; flags are booleans

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sawmill_command.data_option import Data, storage_settings
from sawmill_worker.commands.terminal import Command, ending_when_terminated, say, showing_progress

if TYPE_CHECKING:
    from sawmill_platform.backups.backup import Manifest

app = typer.Typer()

_MOST_NAMED = 20


@app.command(cls=Command)
def backup(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Folder of backups, on another disk; it must be there.")
    ],
    keep: Annotated[
        int | None, typer.Option(min=1, help="Keep that many of the newest backups there and remove the others.")
    ] = None,
    data: Data = None,
) -> None:
    """Back up rows and files while the service runs, into a new folder that is named by the time.

    Files that an earlier backup in the folder has are not copied again, where its file system has hard links.
    """
    from sawmill_platform.backups.taking import note_newest, remove_older, take_backup
    from sawmill_store.mill_files import NAMED_FOLDERS

    settings = storage_settings(data)
    with _reported("There is no backup"), showing_progress("backup") as on_progress:
        taken = take_backup(settings, folder, on_progress, named=NAMED_FOLDERS)
    typer.echo(taken.path)
    new = f"{taken.number_of_files} files are in it, and {taken.copied_bytes / 1e9:.2f} GB were copied"
    say(f"{_described(taken.manifest)} is there: {new}.")
    with _reported("The backup is whole, but sawmill doctor will not know of it"):
        note_newest(settings.data_folder, taken)
    if taken.manifest.lacking:
        _end_with(taken.manifest.lacking, "The backup lacks what rows name and could not be read")
    if keep is not None:
        with _reported("Older backups are still there"):
            for path in remove_older(folder, keep, taken.path):
                say(f"{path} was removed.")


@app.command(cls=Command)
def restore(
    backup: Annotated[Path, typer.Argument(metavar="BACKUP", help="Folder of one backup.")],
    check: Annotated[
        bool, typer.Option("--check", help="Read the whole backup and compare every checksum; restore nothing.")
    ] = False,
    data: Data = None,
) -> None:
    """Restore a backup into an empty data folder and an empty database, every checksum compared."""
    import sawmill_store.mill_files  # noqa: F401 - declares the tables, their migrations and the kinds of jobs
    from sawmill_platform.backups.backup import Backup
    from sawmill_platform.backups.restoring import restore as restore_backup

    if check:
        with _reported("This backup cannot be restored"), showing_progress("check") as on_progress:
            checked = Backup(backup)
            problems = checked.damage(on_progress)
        if problems:
            say("Remove a damaged file from the newest backup: the next one copies it anew, from the data folder.")
            _end_with(problems, "The backup is damaged")
        say(f"{_described(checked.manifest)} is whole.")
        return
    settings = storage_settings(data)
    with _reported("Nothing was restored"), showing_progress("restore") as on_progress:
        done = restore_backup(backup, settings, on_progress)
    what = "What an earlier restore had read" if done is None else _described(done)
    say(f"{what} is in {settings.data_folder}: the service may start.")


@app.command(cls=Command, name="copy-to-postgresql")
def copy_to_postgresql(data: Data = None) -> None:
    """Copy the rows of a stopped service from SQLite, in its data folder, into the empty database of the settings."""
    import sawmill_store.mill_files  # noqa: F401 - declares the tables, their migrations and the kinds of jobs
    from sawmill_platform.backups.database_copy import copy_rows

    target = storage_settings(data)
    with _reported("Nothing was copied"):
        rows = copy_rows(target.model_copy(update={"database_url": None, "database_password_file": None}), target)
    say(f"{rows} rows were copied: the service may start on PostgreSQL. The file of SQLite is as it was.")


@contextmanager
def _reported(trouble: str) -> Iterator[None]:
    """Report an error in one sentence and end with exit code 1."""
    from sawmill_platform.errors import StorageError

    try:
        with ending_when_terminated():
            yield
    except (StorageError, OSError) as error:
        say(str(error), trouble=trouble)
        raise typer.Exit(1) from error


def _described(manifest: "Manifest") -> str:
    return f"The backup of {manifest.taken_at:%Y-%m-%d %H:%M:%S} UTC"


def _end_with(sentences: Sequence[str], trouble: str) -> None:
    for sentence in sentences[:_MOST_NAMED]:
        say(sentence)
    say(f"{len(sentences)} in all.", trouble=trouble)
    raise typer.Exit(1)
