"""Leftovers of kills and failed commits in the data folder: files that no row names, removed after a grace.

Files get their names before the commit of the row that names them, so a row may name a file a moment later. A file is
removed when no row named it at two checks, a grace apart by the observer's own clock, and no row names it while nobody
can be about to commit such a row (`lock_files_of`).
"""

import re
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from sqlalchemy import select
from sqlalchemy.orm import Session

from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.database.clock import Clock
from sawmill_platform.database.database import Database, lock_files_of
from sawmill_platform.database.tables import JobRow
from sawmill_platform.files.file_store import FileStore
from sawmill_platform.files.named_folders import OF_THE_SERVICE, NamedFolder

NAMES_A_ROUND = 500
_TEMPORARY_NAME = re.compile(r"[0-9a-f]{32}")
_SUBJECT_NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,63}")
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
                self._end_look()
                break
            place, names = batch
            remaining -= len(names)
            removed += self._remove(place, self._ripe(place, names))
        return removed

    def _look(self) -> Iterator[tuple[_Place, list[str]]]:
        for place in self._places:
            names = place.names()
            while batch := list(islice(names, NAMES_A_ROUND)):
                yield place, batch

    def _end_look(self) -> None:
        self._seen, self._seen_again = self._seen_again, {}
        self._batches = self._look()
        self._rests_until_s = self._now_s() + 0.25 * self._grace_s

    def _ripe(self, place: _Place, names: Sequence[str]) -> list[str]:
        with self._database.read() as session:
            unknown = set(names) - place.known(session, names)
        return [name for name in sorted(unknown) if self._stood_still(place.folder / name)]

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
        *(_Place(folder / each.path, _SUBJECT_NAME, _among(each, now)) for each in (*OF_THE_SERVICE, *named)),
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
