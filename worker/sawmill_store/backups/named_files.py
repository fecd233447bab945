"""The files that rows name, as they lie in the data folder."""

import os
import stat
from collections.abc import Collection, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from sqlalchemy import Connection, Select, Table

from sawmill_contracts import job_kinds
from sawmill_contracts.kinds import AskedKind
from sawmill_platform.contracts.jobs import JobKind
from sawmill_platform.contracts.kinds import declaration_of
from sawmill_platform.database.database import Database
from sawmill_platform.database.tables import Base, UploadRow
from sawmill_platform.files.file_store import EXAMPLES, UNFINISHED, UPLOADED_FILE
from sawmill_store.mill_files import SCAN_FILE
from sawmill_store.retention import named_by_rows


class Named(NamedTuple):
    """What rows name.

    Attributes
    ----------
    path : str
        A file or a folder, in the data folder.
    needed : bool
        Whether it must be there; otherwise it may be.
    most_bytes : int or None
        What rows know of the file; None: all that it has.
    file : str
        The file in a folder that must be there; empty: the path is a file itself.
    """

    path: str
    needed: bool
    most_bytes: int | None = None
    file: str = ""


class Found(NamedTuple):
    """A file in the data folder, or an empty folder: without a status."""

    path: str
    status: os.stat_result | None
    most_bytes: int | None = None

    @property
    def size_bytes(self) -> int:
        """What a backup has of it."""
        size_bytes = 0 if self.status is None else self.status.st_size
        return size_bytes if self.most_bytes is None else min(size_bytes, self.most_bytes)

    @property
    def inode(self) -> tuple[int, int] | None:
        """What it shares with its other names; None: it has none."""
        if self.status is None or self.status.st_nlink == 1:
            return None
        return self.status.st_dev, self.status.st_ino


def named_by(connection: Connection, tables: Collection[str]) -> list[Named]:
    """What the rows of a transaction name, in the order of the paths.

    Parameters
    ----------
    tables
        Those that there are: a database may be older than this software.
    """
    folders = {
        f"uploads/{kind.plural}": (
            named_by_rows.uploaded(kind, lambda: datetime.now(UTC)),
            UPLOADED_FILE if kind is job_kinds.INGEST else None,
        )
        for kind in named_by_rows.UPLOADED
    }
    folders |= {kind.plural: (named_by_rows.succeeded(kind), _file_left_by(kind)) for kind in JobKind.all()}
    named = [Named(EXAMPLES, needed=False)]
    for folder, (ids, file) in folders.items():
        if _is_there(ids, tables):
            needed = file is not None
            named += [Named(f"{folder}/{name}", needed, file=file or "") for name in connection.scalars(ids)]
    unused = named_by_rows.unused_uploads()
    if _is_there(unused, tables):
        rows = connection.execute(unused.add_columns(UploadRow.offset_bytes))
        named += [Named(f"{UNFINISHED}/{name}", size > 0, size) for name, size in rows]
    return sorted(named)


def look_for(folder: Path, named: list[Named]) -> tuple[list[Found], list[str]]:
    """Files that are named and there, and paths of those that should be and are not."""
    found, lacking = list[Found](), list[str]()
    for one in named:
        try:
            status = (folder / one.path).stat()
        except FileNotFoundError:
            if one.needed:
                lacking.append(one.path)
            continue
        try:
            if stat.S_ISDIR(status.st_mode):
                found += list(_below(folder, one.path))
            elif stat.S_ISREG(status.st_mode):
                found.append(Found(one.path, status, one.most_bytes))
            elif one.needed:
                lacking.append(one.path)
        except FileNotFoundError:  # it is being removed: the next look will tell whether rows still name it
            lacking.append(one.path)
    return found, lacking


def lost_files(database: Database, folder: Path) -> list[str]:
    """Find the files that rows name and the data folder lacks; their paths in it.

    Raises
    ------
    StorageUnavailable
        The database does not answer.
    OSError
        The data folder cannot be read.
    """
    lost = _lost(database, folder)
    # A row is deleted before its files: what is lacking for that reason has no row at the second look.
    return sorted(lost & _lost(database, folder)) if lost else []


def _lost(database: Database, folder: Path) -> set[str]:
    with database.read() as session:
        named = named_by(session.connection(), Base.metadata.tables)
    paths = (f"{one.path}/{one.file}" if one.file else one.path for one in named if one.needed)
    return {path for path in paths if not _exists(f"{folder}/{path}")}


def _exists(path: str) -> bool:
    try:
        os.stat(path)  # noqa: PTH116 - tens of thousands of them
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True


def _file_left_by(kind: JobKind) -> str | None:
    declared = declaration_of(kind)
    if kind is job_kinds.INGEST:
        return SCAN_FILE
    return declared.result_file if isinstance(declared, AskedKind) else None


def _is_there(ids: Select[str], tables: Collection[str]) -> bool:
    return all(isinstance(source, Table) and source.name in tables for source in ids.columns_clause_froms)


def _below(folder: Path, path: str) -> Iterator[Found]:
    with os.scandir(folder / path) as entries:
        below = sorted(entries, key=lambda entry: entry.name)
    if not below:
        yield Found(path, None)
    for entry in below:
        if entry.is_dir():
            yield from _below(folder, f"{path}/{entry.name}")
        else:
            yield Found(f"{path}/{entry.name}", entry.stat())
