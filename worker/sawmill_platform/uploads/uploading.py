"""Uploads and their rows, which become durable together or not at all."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from functools import partial

from sqlalchemy.orm import Session

from sawmill_platform.contracts.jobs import JobKind
from sawmill_platform.database.database import after_commit, lock_files_of
from sawmill_platform.errors import StorageFull
from sawmill_platform.files.file_store import FileStore
from sawmill_platform.files.upload_stream import Received
from sawmill_platform.uploads.upload_store import use_up


@contextmanager
def kept_upload(
    files: FileStore, received: Received, kind: JobKind, subject_id: str
) -> Iterator[Callable[[Session, datetime], None]]:
    """Yield the function that gives the upload its owner; call it last in the transaction that writes the rows.

    An upload that can be resumed is used up in the same transaction. After the commit its own name is removed, or with
    the `leftovers` if the process was killed between the two.

    If the block raises before that call, the upload is discarded; a file that an older subject of the same id owns is
    not touched. After the call, only the commit can fail. A full disk is the database's own answer: there are no rows,
    and the upload is removed. After a lost connection the commit may have succeeded: then the upload stays at the place
    that its row names, and is removed with the `leftovers` if there is no row.
    """
    named = False

    def keep(session: Session, now: datetime) -> None:
        nonlocal named
        lock_files_of(session, subject_id)
        named = True
        use_up(session, now, received, kind, subject_id)
        files.keep_upload(received, kind, subject_id)

    try:
        yield keep
    except BaseException as error:
        files.discard(received)
        if named and isinstance(error, StorageFull):
            files.remove_upload(kind, subject_id)
        raise
    if received.upload_id is not None:
        after_commit(partial(files.unfinished(received.upload_id).unlink, missing_ok=True))
