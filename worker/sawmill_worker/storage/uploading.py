"""An upload and its rows become durable together, or not at all."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from sawmill_worker.contracts.jobs import JobKind
from sawmill_worker.storage.files import FileStore, Received


@contextmanager
def kept_upload(files: FileStore, received: Received, kind: JobKind, subject_id: str) -> Iterator[Callable[[], None]]:
    """Yield the function that gives the upload its owner; call it last in the transaction that writes the rows.

    When the block raises, the commit included, the upload is removed wherever it is by then; a file
    that an older subject of the same id owns is not touched.
    """
    kept = False

    def keep() -> None:
        nonlocal kept
        files.keep_upload(received, kind, subject_id)
        kept = True

    try:
        yield keep
    except BaseException:
        files.discard(received)
        if kept:
            files.remove_upload(kind, subject_id)
        raise
