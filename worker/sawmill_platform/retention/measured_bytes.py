"""Sizes of the stored files, bytes: measured once, after the job that wrote the files has ended.

The database adds the sizes up. A walk through the files of a year would take minutes.
"""

import os
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

from sqlalchemy import bindparam, exists, select, update

from sawmill_platform.contracts.jobs import ENDED, JobKind
from sawmill_platform.database.database import Database
from sawmill_platform.database.tables import JobRow
from sawmill_platform.files.file_store import FileStore
from sawmill_platform.retention.stocks import Stock

MEASURED_A_ROUND = 500


def places_of(files: FileStore, kind: JobKind, subject_id: str) -> list[Path]:
    """Return the folders of a job's subject, which may or may not exist."""
    return [files.results(kind, subject_id), files.upload(kind, subject_id).parent]


def measure_some(database: Database, files: FileStore, stocks: Iterable[Stock]) -> bool:
    """Write the bytes of the next rows that are not measured; return whether there may be more.

    Raises
    ------
    StorageFull, StorageUnavailable
        The database cannot write.
    """
    more = False
    for table, kind in {stock.table: stock.job for stock in stocks if stock.has_bytes}.items():
        ended = exists().where(JobRow.id == table.job_id, JobRow.state.in_(ENDED))
        unmeasured = select(table.id).where(table.stored_bytes.is_(None), ended).limit(MEASURED_A_ROUND)
        with database.read() as session:
            identifiers = session.scalars(unmeasured).all()
        if not identifiers:
            continue
        sizes = [{"which": each, "size": _bytes_of(places_of(files, kind, each))} for each in identifiers]
        columns = table.__table__.c
        written = update(table.__table__).where(columns.id == bindparam("which"))
        with database.write() as session:
            session.connection().execute(written.values(stored_bytes=bindparam("size")), sizes)
        more = more or len(identifiers) == MEASURED_A_ROUND
    return more


def freed_bytes_of(places: Iterable[Path]) -> int:
    """Return the bytes that removing these folders frees; a file that has a further name elsewhere stays."""
    names, sizes = Counter[tuple[int, int]](), dict[tuple[int, int], tuple[int, int]]()
    for status in _files_in(places):
        inode = status.st_dev, status.st_ino
        names[inode] += 1
        sizes[inode] = status.st_nlink, status.st_size
    return sum(size for inode, (links, size) in sizes.items() if names[inode] >= links)


def _bytes_of(places: Iterable[Path]) -> int:
    return sum(status.st_size for status in _files_in(places))


def _files_in(places: Iterable[Path]) -> Iterator[os.stat_result]:
    for place in places:
        try:
            with os.scandir(place) as entries:
                yield from (entry.stat(follow_symlinks=False) for entry in entries if entry.is_file())
        except FileNotFoundError:
            continue
