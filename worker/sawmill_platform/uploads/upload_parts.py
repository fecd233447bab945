"""Part of an upload that can be resumed: written, flushed, and only then counted in the upload's row."""

import fcntl
import hashlib
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from sqlalchemy import delete, update
from sqlalchemy.orm import Session

from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.uploads import Upload, UploadState
from sawmill_platform.database.database import Database
from sawmill_platform.database.tables import UploadRow
from sawmill_platform.errors import Busy, Conflict, Damaged, NotFound, disk_outage_reported
from sawmill_platform.files.upload_stream import STEP_BYTES, Content, check_free
from sawmill_platform.files.whole_files import flush
from sawmill_platform.ledger.events import announce

# A service that is killed loses the bytes of this time, or `STEP_BYTES`, whichever is less.
_STEP_S = 1.0
_PIECE_BYTES = 2**20


class UploadPart:
    """The file of an upload, locked by the system, so that it is free again however its writer ends.

    Parameters
    ----------
    path
        Path of the file, which is made if it is missing.

    Raises
    ------
    Busy
        Another part of the upload is being received.
    """

    def __init__(self, path: Path, upload_id: str, database: Database) -> None:
        self._path, self._id, self._database = path, upload_id, database
        # A cancelled receiver closes the file while a thread may still write to it.
        self._writing = threading.Lock()
        self._closed = False
        with disk_outage_reported("the upload"):
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._file)
            raise Busy(
                "upload-busy",
                f"another part of upload {upload_id!r} is coming: wait for its end, and ask for the offset",
            ) from None

    def begin(self, upload: Upload, *, reserve_bytes: int = 0) -> None:
        """Continue at the row's offset.

        Raises
        ------
        Conflict
            The file has lost bytes that the row counts.
        """
        self.upload, self._reserve_bytes = upload, reserve_bytes
        self._committed = self._written = upload.offset_bytes
        self._flushed, self._flushed_s = self._written, time.monotonic()
        if os.fstat(self._file).st_size < upload.offset_bytes:
            raise lost(self._id)
        os.ftruncate(self._file, upload.offset_bytes)
        os.lseek(self._file, upload.offset_bytes, os.SEEK_SET)

    @property
    def missing_bytes(self) -> int:
        """Bytes that must still arrive before the file is complete."""
        return self.upload.size_bytes - self._written

    def take(self, content: Content, part: bytes, *, commits: bool) -> None:
        """Write the next bytes, and flush now and then; if `commits`, bytes are counted before the part is complete.

        Raises
        ------
        Conflict, NotFound, StorageFull
            The file would become too long, has been deleted, or there is no room for it.
        """
        for chunk in content.take(part):
            if self._written + len(chunk) > self.upload.size_bytes:
                raise Conflict(
                    "upload-too-long",
                    f"more comes than the {self.upload.size_bytes} bytes that upload {self._id!r} was declared with",
                )
            with self._open(), disk_outage_reported("the upload"):
                left = memoryview(chunk)
                while left:
                    left = left[os.write(self._file, left) :]
            self._written += len(chunk)
        if self._written - self._flushed >= STEP_BYTES or time.monotonic() - self._flushed_s > _STEP_S:
            check_free(self._path.parent, self._reserve_bytes, needed_by="SAWMILL_DISK_RESERVE_BYTES")
            if commits:
                self.commit()
            else:
                self._flush()

    def commit(self) -> None:
        """Make the received bytes durable, then count them."""
        self._flush()
        with self._database.write() as session:
            self._change(session, offset_bytes=self._written)
        self._committed = self._written

    def finish(self, content: Content) -> None:
        """Count the rest of a part that is complete."""
        content.end()
        self.commit()

    def complete(self) -> None:
        """Make the upload complete; for a large file the digest takes long.

        Raises
        ------
        Damaged
            The file is another one than declared: nothing of it is kept.
        NotFound
            The upload has been deleted.
        """
        # The file on the disk is read, because several processes may have received its parts; this ends when the part
        # is closed.
        computed = hashlib.sha256()
        for begin in range(0, self.upload.size_bytes, _PIECE_BYTES):
            with self._open():
                piece = os.pread(self._file, _PIECE_BYTES, begin)
            computed.update(piece)
        sha256 = computed.hexdigest()
        if self.upload.sha256 not in {None, sha256}:
            with self._database.write() as session:
                session.execute(delete(UploadRow).where(UploadRow.id == self._id))
                announce_deleted(session, self._database.now(), self._id, "the file that came has another sha256")
            self._path.unlink(missing_ok=True)
            raise Damaged(f"the file that came has the sha256 {sha256}, not {self.upload.sha256}: send it again")
        with self._database.write() as session:
            now = self._change(session, sha256=sha256, state=UploadState.COMPLETE)
            announce(session, now, event_kinds.UPLOAD_COMPLETE, "upload", self._id)

    def close(self) -> None:
        """Release the file for other writers."""
        with self._open():
            self._closed = True
            os.close(self._file)

    @contextmanager
    def _open(self) -> Iterator[None]:
        with self._writing:
            if self._closed:
                raise Busy("upload-busy", f"this part of upload {self._id!r} was ended: ask for the offset")
            yield

    def _flush(self) -> None:
        """Make the received bytes durable, at first with the file's name."""
        with self._open(), disk_outage_reported("the upload"):
            os.fdatasync(self._file)
            if not self._committed:
                flush(self._path.parent)
        self._flushed, self._flushed_s = self._written, time.monotonic()

    def _change(self, session: Session, **values: object) -> datetime:
        """Change the row if it is as this part knows it, and return the time of the change; raise if it is gone."""
        now = self._database.now()
        mine = (UploadRow.id == self._id, UploadRow.offset_bytes == self._committed)
        changed = session.execute(update(UploadRow).where(*mine).values(changed_at=now, **values))
        if changed.rowcount != 1:  # type: ignore[attr-defined]
            raise NotFound("upload", self._id)
        return now


def lost(upload_id: str) -> Conflict:
    """Return the conflict for a file that has lost bytes which the row counts."""
    return Conflict("upload-lost", f"the bytes of upload {upload_id!r} are gone: delete it, and send them again")


def announce_deleted(session: Session, now: datetime, upload_id: str, reason: str) -> None:
    """Announce to followers that an upload has gone, and why."""
    announce(session, now, event_kinds.UPLOAD_DELETED, "upload", upload_id, detail={"reason": reason})
