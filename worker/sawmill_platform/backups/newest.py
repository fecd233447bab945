"""Note of the newest backup in the data folder, for the operator of the service."""

from pathlib import Path

from pydantic import ValidationError

from sawmill_platform.backups.manifest import Manifest
from sawmill_platform.contracts.base import Contract, Time
from sawmill_platform.files.file_store import LAST_BACKUP
from sawmill_platform.files.whole_files import renamed


class Newest(Contract):
    """The last backup of a data folder.

    Attributes
    ----------
    path
        Path to which the backup was written; it may have been moved since.
    taken_at
        Instant of the rows.
    lacking
        Number of files that the backup lacks.
    """

    path: str
    taken_at: Time
    lacking: int


def note_newest(folder: Path, path: Path, manifest: Manifest) -> None:
    """Write the note of a complete backup."""
    note = Newest(path=str(path), taken_at=manifest.taken_at, lacking=len(manifest.lacking))
    new = folder / f"{LAST_BACKUP}.new"
    with renamed(new, folder / LAST_BACKUP):
        new.write_text(note.model_dump_json())


def newest_backup(folder: Path) -> Newest | None:
    """Read the note of the last backup of a data folder; None where there is no readable note."""
    try:
        return Newest.model_validate_json((folder / LAST_BACKUP).read_text())
    except (FileNotFoundError, ValidationError):
        return None
