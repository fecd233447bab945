"""Which backup was the last one: a note in the data folder, for whoever looks after the service."""

from pathlib import Path

from pydantic import ValidationError

from sawmill_platform.contracts.base import Contract, Time
from sawmill_platform.files.file_store import LAST_BACKUP
from sawmill_platform.files.whole_files import renamed
from sawmill_store.backups.manifest import Manifest


class Newest(Contract):
    """The last backup of a data folder.

    Attributes
    ----------
    path
        Where it was written; it may have been taken away since.
    taken_at
        The instant of its rows.
    lacking
        The number of files that it lacks.
    """

    path: str
    taken_at: Time
    lacking: int


def note_newest(folder: Path, path: Path, manifest: Manifest) -> None:
    """Note a backup that is whole."""
    note = Newest(path=str(path), taken_at=manifest.taken_at, lacking=len(manifest.lacking))
    new = folder / f"{LAST_BACKUP}.new"
    with renamed(new, folder / LAST_BACKUP):
        new.write_text(note.model_dump_json())


def newest_backup(folder: Path) -> Newest | None:
    """The last backup that was taken of a data folder; None: there is no note that can be read."""
    try:
        return Newest.model_validate_json((folder / LAST_BACKUP).read_text())
    except (FileNotFoundError, ValidationError):
        return None
