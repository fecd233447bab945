"""Folders of the data folder in which rows name files, as the package that owns the rows declares them; the files."""

import os
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from sqlalchemy import Connection, Select, Table, select

from sawmill_platform.contracts.jobs import UNFINISHED
from sawmill_platform.contracts.uploads import UploadState
from sawmill_platform.database.clock import Clock
from sawmill_platform.database.database import Database
from sawmill_platform.database.tables import Base, JobRow, UploadRow
from sawmill_platform.files import file_store

Ids = Select[str]
"""Statement that selects ids, to which a condition may be added."""


@dataclass(frozen=True)
class NamedFolder:
    """A folder of the data folder that has a folder for each id of some rows."""

    path: str  # path in the data folder, with slashes
    ids: Callable[[Clock], Ids]  # maps a clock to the statement of the ids whose files are kept now
    file: str | None = None  # name of the file that each folder must have. None: a folder may be missing.


def unused_uploads() -> Ids:
    """Select the uploads that may have a file in `unfinished`."""
    return select(UploadRow.id).where(UploadRow.state != UploadState.USED)


OF_THE_SERVICE = (
    NamedFolder("kept", lambda _: select(JobRow.id).where(JobRow.state.in_(UNFINISHED))),
    NamedFolder(file_store.UNFINISHED, lambda _: unused_uploads()),
)
"""Folders of checkpoints and unfinished uploads."""


class Named(NamedTuple):
    """A path that rows name, whether it must exist, the bytes that count (None: all), and the file within."""

    path: str
    needed: bool
    most_bytes: int | None = None
    file: str = ""


def named_by(connection: Connection, folders: Iterable[NamedFolder], tables: Collection[str]) -> list[Named]:
    """Read the paths that rows name, in the order of the paths; a database may lack tables of this version."""
    named = [Named(file_store.EXAMPLES, needed=False)]
    for folder in folders:
        ids, needed = folder.ids(lambda: datetime.now(UTC)), folder.file is not None
        if _is_there(ids, tables):
            named += [
                Named(f"{folder.path}/{name}", needed, file=folder.file or "") for name in connection.scalars(ids)
            ]
    unused = unused_uploads()
    if _is_there(unused, tables):
        rows = connection.execute(unused.add_columns(UploadRow.offset_bytes))
        named += [Named(f"{file_store.UNFINISHED}/{name}", size > 0, size) for name, size in rows]
    return sorted(named)


def find_named(folder: Path, named: list[Named]) -> tuple[dict[str, int | None], list[str]]:
    """Find the named files, with the number of bytes that count, and the paths that must exist and do not."""
    found, lacking = dict[str, int | None](), list[str]()
    for one in named:
        try:
            below = dict.fromkeys(_below(folder, one.path), one.most_bytes)
        except FileNotFoundError:
            if one.needed:
                lacking.append(one.path)
        else:
            found |= below
    return found, lacking


def lost_files(database: Database, folders: Sequence[NamedFolder], folder: Path) -> list[str]:
    """Find the paths in the data folder of files that rows name and that are missing."""
    lost = _lost(database, folders, folder)
    # A row is deleted before its files: a file that is missing for this reason has no row in the second pass.
    return sorted(lost & _lost(database, folders, folder)) if lost else []


def _lost(database: Database, folders: Sequence[NamedFolder], folder: Path) -> set[str]:
    with database.read() as session:
        named = named_by(session.connection(), folders, Base.metadata.tables)
    paths = (f"{one.path}/{one.file}" if one.file else one.path for one in named if one.needed)
    return {path for path in paths if not _exists(f"{folder}/{path}")}


def _exists(path: str) -> bool:
    try:
        os.stat(path)  # noqa: PTH116 - tens of thousands of them
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True


def _is_there(ids: Select[str], tables: Collection[str]) -> bool:
    return all(isinstance(source, Table) and source.name in tables for source in ids.columns_clause_froms)


def _below(folder: Path, path: str) -> Iterator[str]:
    try:
        entries = os.scandir(folder / path)
    except NotADirectoryError:
        yield path
        return
    with entries:
        for entry in entries:
            if entry.is_dir():
                yield from _below(folder, f"{path}/{entry.name}")
            else:
                yield f"{path}/{entry.name}"
