"""Folders of the data folder in which rows name files, as the package that owns the rows declares them; leftovers.

Leftovers of kills and failed commits are files that no row names. Files get their names before the commit of the row
that names them, so a row may name a file a moment later. A file is removed when no row named it at two checks, a grace
apart by the observer's own clock, and no row names it while nobody can be about to commit such a row
(`lock_files_of`).
"""

import os
import re
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from sqlalchemy import Connection, Select, Table, select
from sqlalchemy.orm import Session

from sawmill_platform.contracts.jobs import UNFINISHED, JobState
from sawmill_platform.contracts.uploads import UploadState
from sawmill_platform.database.clock import Clock
from sawmill_platform.database.database import Database, lock_files_of
from sawmill_platform.database.tables import Base, JobRow, UploadRow
from sawmill_platform.files import file_store
from sawmill_platform.files.file_store import FileStore

Ids = Select[str]  # statement that selects ids, to which a condition may be added


@dataclass(frozen=True)
class NamedFolder:
    """A folder of the data folder that has a folder for each id of some rows."""

    path: str  # path in the data folder, with slashes
    ids: Callable[[Clock], Ids]  # maps a clock to the statement of the ids whose files are kept now
    file: str | None = None  # name of the file that each folder must have. None: a folder may be missing.


def unused_uploads() -> Ids:
    """Select the uploads that may have a file in `unfinished`."""
    return select(UploadRow.id).where(UploadRow.state != UploadState.USED)


# Folders of checkpoints and unfinished uploads.
OF_THE_SERVICE = (
    NamedFolder("kept", lambda _: select(JobRow.id).where(JobRow.state.in_(UNFINISHED))),
    NamedFolder(file_store.UNFINISHED, lambda _: unused_uploads()),
)


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


NAMES_A_ROUND = 500
_TEMPORARY_NAME = re.compile(r"[0-9a-f]{32}")
# Name of an attempt: a job and a number; the first versions had no third part.
_ATTEMPT_NAME = re.compile(r"([a-z0-9][a-z0-9-]*?)-(\d+)(?:-[0-9a-f]{32})?")

Known = Callable[[Session, Sequence[str]], set[str]]


class _Place(NamedTuple):
    """A folder, the pattern of our names in it, and the names that rows know."""

    folder: Path
    name: re.Pattern[str]
    known: Known

    def names(self) -> Iterator[str]:
        try:
            yield from (path.name for path in self.folder.iterdir() if self.name.fullmatch(path.name))
        except FileNotFoundError:
            return


class Leftovers:
    """Remover of files that no row of `named` names for `grace_s`, a few at a time; several processes may have one."""

    def __init__(
        self,
        database: Database,
        files: FileStore,
        named: Iterable[NamedFolder],
        *,
        grace_s: float,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._database = database
        self._files = files
        self._grace_s = grace_s
        self._now_s = now_s
        self._places = _places(files.folder, named, database.now)
        self._batches = self._look()
        self._rests_until_s = now_s()
        # For each path: the time of the first check, and the state of the file then.
        self._seen: dict[Path, tuple[float, object]] = {}
        self._seen_again: dict[Path, tuple[float, object]] = {}

    def remove_some(self) -> list[Path]:
        """Check the next names, a quarter of a grace after the last time, and return the paths that were removed.

        Raises `OSError` if a file could not be removed; all other files of the round were.
        """
        remaining, removed = NAMES_A_ROUND, list[Path]()
        while remaining > 0 and self._now_s() >= self._rests_until_s:
            batch = next(self._batches, None)
            if batch is None:
                self._seen, self._seen_again = self._seen_again, {}
                self._batches = self._look()
                self._rests_until_s = self._now_s() + 0.25 * self._grace_s
                break
            place, names = batch
            remaining -= len(names)
            with self._database.read() as session:
                unknown = set(names) - place.known(session, names)
            removed += self._remove(place, [name for name in sorted(unknown) if self._stood_still(place.folder / name)])
        return removed

    def _look(self) -> Iterator[tuple[_Place, list[str]]]:
        for place in self._places:
            names = place.names()
            while batch := list(islice(names, NAMES_A_ROUND)):
                yield place, batch

    def _stood_still(self, path: Path) -> bool:
        look = _look_of(path)
        first_s, before = self._seen.get(path, (self._now_s(), None))
        if path not in self._seen or before != look:
            first_s = self._now_s()
        self._seen_again[path] = (first_s, look)
        return path in self._seen and before == look and self._now_s() - first_s >= self._grace_s

    def _remove(self, place: _Place, names: Sequence[str]) -> list[Path]:
        if not names:
            return []
        aside, errors = dict[Path, Path | None](), list[OSError]()
        with self._database.write() as session:
            locked = [name for name in names if lock_files_of(session, name, wait=False)]
            named = place.known(session, locked)
            for path in (place.folder / name for name in locked if name not in named):
                with noted(errors):
                    aside[path] = self._files.set_aside(path)
        # The files are removed outside the transaction, because that may take long.
        for parting in filter(None, aside.values()):
            with noted(errors):
                self._files.delete(parting)
        if errors:
            raise errors[0]
        return [path for path, parting in aside.items() if parting is not None]


@contextmanager
def noted(errors: list[OSError]) -> Iterator[None]:
    """Collect the error of a file that cannot be removed, so that the next files are removed nevertheless."""
    try:
        yield
    except OSError as error:
        errors.append(error)


def _places(folder: Path, named: Iterable[NamedFolder], now: Clock) -> list[_Place]:
    return [
        *(_Place(folder / name, _TEMPORARY_NAME, lambda _, __: set()) for name in ("incoming", "removed")),
        _Place(folder / "attempts", _ATTEMPT_NAME, _running_attempts),
        *(_Place(folder / each.path, file_store.SAFE_NAME, _among(each, now)) for each in (*OF_THE_SERVICE, *named)),
    ]


def _among(named: NamedFolder, now: Clock) -> Known:
    def known(session: Session, names: Sequence[str]) -> set[str]:
        statement = named.ids(now)
        (identifier,) = statement.selected_columns
        return set(session.scalars(statement.where(identifier.in_(names))))

    return known


def _running_attempts(session: Session, names: Sequence[str]) -> set[str]:
    parts = {name: match.groups() for name in names if (match := _ATTEMPT_NAME.fullmatch(name))}
    jobs = {job_id for job_id, _ in parts.values()}
    running = session.execute(
        select(JobRow.id, JobRow.attempt).where(JobRow.id.in_(jobs), JobRow.state == JobState.RUNNING)
    )
    attempts = {(job_id, str(attempt)) for job_id, attempt in running}
    return {name for name, part in parts.items() if part in attempts}


def _look_of(path: Path) -> object:
    """Return the time and size of a file, which change when somebody writes to it; None where the file has gone."""
    try:
        status = path.stat()
    except FileNotFoundError:
        return None
    return status.st_mtime_ns, status.st_size
