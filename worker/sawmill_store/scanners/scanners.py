"""Scanners and which calibration each of them uses."""

import os
from collections.abc import Iterable, Sequence
from datetime import datetime
from functools import partial
from pathlib import Path

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from sawmill_contracts import mill_events
from sawmill_contracts.scanners import ScannerSpec, StoredScanner
from sawmill_contracts.watched_folders import WatchedFolder
from sawmill_platform.contracts.base import Page
from sawmill_platform.contracts.event_kinds import EventType
from sawmill_platform.database.database import Database, lock_files_of
from sawmill_platform.database.paging import Check, accept_any, found, new_id, read_page, refuse_taken
from sawmill_platform.database.tables import Json
from sawmill_platform.errors import Conflict, Invalid
from sawmill_platform.ledger.audit import changed
from sawmill_platform.ledger.events import announce
from sawmill_store.activations import active_calibration_id
from sawmill_store.mill_tables import MeasurementRow, ScannerRow, ScanRow, ScheduleRow
from sawmill_store.requests.references import kept_by
from sawmill_store.scanners.alarms import close_alarms
from sawmill_store.scanners.history import changes_in_words, forget_history


class Scanners:
    """Store of scanners: every method is one transaction.

    Parameters
    ----------
    database
        Database with the rows.
    watch_folders
        Folders in which scanners may have watched folders.
    """

    def __init__(self, database: Database, watch_folders: Sequence[Path] = ()) -> None:
        self._database = database
        self._watch_folders = watch_folders

    def create(self, spec: ScannerSpec, *, scanner_id: str | None = None) -> StoredScanner:
        """Add a scanner.

        Raises
        ------
        Conflict
            The id is taken.
        Invalid
            The folder may not be watched for this scanner.
        """
        self._check_folder(spec.watched_folder)
        row = ScannerRow(id=scanner_id or new_id(), created_at=self._database.now(), spec=spec.model_dump(mode="json"))
        with self._database.write() as session:
            refuse_taken(session, ScannerRow, "scanner", row.id)
            _check_apart(session, row.id, spec.watched_folder)
            session.add(row)
            _announce(session, row.created_at, mill_events.SCANNER_CREATED, row.id, {"name": spec.name})
            return read_scanner(session, row)

    def get(self, scanner_id: str) -> StoredScanner:
        """Return a scanner, or raise `NotFound`."""
        with self._database.read() as session:
            return read_scanner(session, found(session, ScannerRow, "scanner", scanner_id))

    def page(self, *, after: str | None = None, limit: int = 50) -> Page[StoredScanner]:
        """Return a page of scanners, newest first."""
        with self._database.read() as session:
            read = partial(read_scanner, session)
            return read_page(session, select(ScannerRow), ScannerRow, read, after=after, limit=limit)

    def names(self) -> dict[str, str]:
        """Return the names of all scanners by id, in the order of the names."""
        with self._database.read() as session:
            rows = session.execute(select(ScannerRow.id, ScannerRow.spec)).all()
        return dict(sorted(((identifier, spec["name"]) for identifier, spec in rows), key=lambda item: item[1]))

    def watched_folders(self) -> dict[str, WatchedFolder]:
        """Return the watched folders by the scanners' ids."""
        with self._database.read() as session:
            return _watched_folders(session)

    def ids_of(self, names: Iterable[str]) -> set[str]:
        """Return the ids of scanners that are given by id or name; a shared name means all scanners of that name.

        Raises
        ------
        Invalid
            There is no such scanner.
        """
        name_of, ids = self.names(), set[str]()
        for name in names:
            identifiers = {name} & name_of.keys() or {each for each in name_of if name_of[each] == name}
            if not identifiers:
                existing = ", ".join(map(repr, name_of.values())) or "none"
                raise Invalid(
                    "scanner-not-found", f"there is no scanner of the id or name {name!r}; by name: {existing}"
                )
            ids |= identifiers
        return ids

    def update(self, scanner_id: str, spec: ScannerSpec, *, check: Check[StoredScanner] = accept_any) -> StoredScanner:
        """Replace a scanner's description; existing results keep the constants with which they were computed.

        Raises
        ------
        NotFound, Invalid
            There is no such scanner, or the folder may not be watched for it.
        """
        if spec.watched_folder != self.get(scanner_id).watched_folder:  # a stored one stays whatever is allowed now
            self._check_folder(spec.watched_folder)
        with self._database.write() as session:
            row = found(session, ScannerRow, "scanner", scanner_id, lock=True)
            check(read_scanner(session, row))
            _check_apart(session, scanner_id, spec.watched_folder)
            before, row.spec = row.spec, spec.model_dump(mode="json")
            difference = changed(before, row.spec)
            now = self._database.now()
            _announce(session, now, mill_events.SCANNER_CHANGED, scanner_id, difference, changes_in_words(difference))
            return read_scanner(session, row)

    def delete(self, scanner_id: str) -> None:
        """Remove a scanner that nothing refers to.

        Raises
        ------
        NotFound, Conflict
            There is no such scanner, or scans, results, schedules or measurements refer to it.
        """
        with self._database.write() as session:
            row = found(session, ScannerRow, "scanner", scanner_id, lock=True)
            scans = session.scalar(select(func.count()).where(ScanRow.scanner_id == scanner_id)) or 0
            schedules = session.scalar(select(func.count()).where(ScheduleRow.scanner_id == scanner_id)) or 0
            kept = kept_by(session, "scanner_id", scanner_id)
            measured = select(func.count()).where(MeasurementRow.scanner_id == scanner_id)
            measurements = ("measurements", session.scalar(measured) or 0)
            for plural, used in [("scans", scans), *kept, ("schedules", schedules), measurements]:
                if used:
                    raise Conflict(
                        "scanner-in-use", f"scanner {scanner_id!r} is used by {used} {plural}; a used scanner stays"
                    )
            now = self._database.now()
            close_alarms(session, now, scanner_id)
            _announce(session, now, mill_events.SCANNER_DELETED, scanner_id, row.spec)
            session.flush()
            forget_history(session, scanner_id)
            session.delete(row)

    def _check_folder(self, watched: WatchedFolder | None) -> None:
        """Refuse a folder that is not allowed or leads elsewhere; a share may not answer, so outside transactions."""
        if watched is None:
            return
        folder = Path(watched.folder)
        root = next((each for each in self._watch_folders if folder.is_relative_to(each)), None)
        if root is None:
            allowed = ", ".join(map(str, self._watch_folders)) or "no folder"
            raise Invalid(
                "folder-refused",
                f"{folder} may not be watched: SAWMILL_WATCH_FOLDERS, which the administrator sets, allows {allowed}",
            )
        ways = [each for each in (folder, *folder.parents) if each != root and each.is_relative_to(root)]
        link = next((each for each in ways if os.path.islink(each)), None)  # noqa: PTH114 - false for a closed folder
        if link is not None:
            raise Invalid("folder-refused", f"{link} is a link: name the folder itself")


def _check_apart(session: Session, scanner_id: str, watched: WatchedFolder | None) -> None:
    if watched is None:
        return
    lock_files_of(session, "watched folders")
    folder = Path(watched.folder)
    for other_id, other in _watched_folders(session).items():
        path = Path(other.folder)
        if other_id != scanner_id and (folder.is_relative_to(path) or path.is_relative_to(folder)):
            raise Invalid(
                "folder-refused",
                f"{folder} is, holds or lies in the watched folder of scanner {other_id!r}: choose another folder",
            )


def _watched_folders(session: Session) -> dict[str, WatchedFolder]:
    rows = session.execute(select(ScannerRow.id, ScannerRow.spec))
    stored = {scanner_id: spec.get("watched_folder") for scanner_id, spec in rows}  # an earlier version wrote none
    return {scanner_id: WatchedFolder.model_validate(folder) for scanner_id, folder in stored.items() if folder}


def _announce(
    session: Session, now: datetime, what: EventType, scanner_id: str, decided: Json, why: str | None = None
) -> None:
    announce(session, now, what, "scanner", scanner_id, group_id=scanner_id, decided=decided, why=why)


def read_scanner(session: Session, row: ScannerRow) -> StoredScanner:
    """Read the scanner of a row, with its active calibration."""
    return scanner_with(row, active_calibration_id(session, row.id))


def scanner_with(row: ScannerRow, active_id: str | None) -> StoredScanner:
    """Return the scanner of a row whose active calibration was read before."""
    return StoredScanner.model_validate(
        {**row.spec, "id": row.id, "created_at": row.created_at, "active_calibration_id": active_id}
    )
