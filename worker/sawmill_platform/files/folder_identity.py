"""The identity of a data folder: a random id, in a file of the folder and in a row of the database.

A process whose share is not mounted sees an empty folder, or another one. The process recognises this by the identity,
and does nothing there. A copied folder keeps its identity; a restore gives folder and database a new one.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from uuid import uuid4

from sqlalchemy import Connection, insert, select
from sqlalchemy.orm import Session

from sawmill_platform.contracts.jobs import JobKind
from sawmill_platform.database.tables import DataFolderRow
from sawmill_platform.errors import FolderUnavailable, StorageMisconfigured
from sawmill_platform.files.file_store import IDENTITY, UNFINISHED, read_identity
from sawmill_platform.files.whole_files import flush_names, whole_file


def check_identity(connection: Connection | Session, folder: Path) -> None:
    """Check that a folder is the database's folder, or raise `FolderUnavailable`."""
    expected, found = connection.scalar(select(DataFolderRow.identity)), read_identity(folder)
    if found is None:
        raise FolderUnavailable(
            f"the data folder {str(folder)!r} is missing, empty or not mounted: it has no file {IDENTITY!r}, and the "
            f"database expects the folder with the identity {expected}"
        )
    if found != expected:
        raise FolderUnavailable(
            f"the data folder {str(folder)!r} is another one: it has the identity {found!r}, and the database expects "
            f"the folder with the identity {expected}"
        )


def settle_identity(
    connection: Connection,
    is_new: bool,  # noqa: FBT001
    *,
    folder: Path,
    may_begin: bool,
    named: Callable[[Connection], Sequence[Path]],
) -> None:
    """Give a folder and its database one identity if the database has none; otherwise compare the two.

    An empty folder is accepted if it `may_begin` and the rows name no files; of tables of 0.1.0, the folder must have
    some of the `named` files.
    """
    if connection.scalar(select(DataFolderRow.identity)) is not None:
        check_identity(connection, folder)
        return
    due = [] if is_new else named(connection)
    if not (any(path.exists() for path in due) if due else may_begin):
        raise FolderUnavailable(
            f"the data folder {str(folder)!r} is missing, empty or not mounted: it has none of the files that the "
            "database names"
        )
    if is_new:
        refuse_used(folder)
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    # A process that was killed before its commit has left a file.
    write_identity(connection, folder, read_identity(folder) or uuid4().hex)


def refuse_used(folder: Path) -> None:
    """Refuse a folder with files for a new database: raise `StorageMisconfigured`."""
    used = ("uploads", UNFINISHED, *(kind.plural for kind in JobKind.all()))  # what has files after an upload
    if any(any((folder / name).glob("*")) for name in used):
        raise StorageMisconfigured(
            f"the data folder {str(folder)!r} has files, and the database is new and knows none of them: give the "
            "database that belongs to the folder, or an empty folder"
        )


def write_identity(connection: Connection | Session, folder: Path, identity: str) -> None:
    """Write an identity into a folder, and into a database that has none."""
    with whole_file(folder / IDENTITY) as file:
        file.write(f"{identity}\n".encode())
    flush_names(folder)
    connection.execute(insert(DataFolderRow).values(number=1, identity=identity))
