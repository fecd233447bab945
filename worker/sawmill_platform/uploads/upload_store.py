"""Uploads that can be resumed, which become durable together with the row of their subject or not at all.

The bytes that rows count are on the disk; further bytes of a file are ignored.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from functools import partial

from sqlalchemy import ColumnElement, delete, func, select, update
from sqlalchemy.orm import Session

from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.jobs import JobKind
from sawmill_platform.contracts.uploads import UPLOAD_KEPT, Upload, UploadRequest, UploadState
from sawmill_platform.database.database import Database, after_commit, lock_files_of
from sawmill_platform.database.paging import found, new_id, refuse_taken
from sawmill_platform.database.tables import UploadRow
from sawmill_platform.errors import Conflict, NotFound, StorageFull
from sawmill_platform.files.file_store import FileStore
from sawmill_platform.files.folder_identity import check_identity
from sawmill_platform.files.upload_stream import Received
from sawmill_platform.ledger.events import actor, announce
from sawmill_platform.uploads.upload_parts import UploadPart, announce_deleted, lost

_QUOTA_LOCK = "uploads"


@dataclass(frozen=True)
class UploadQuota:
    """Limits on uploads that are not complete or not used yet."""

    # number, size_bytes: number of uploads of one key, and sum of their declared bytes.
    number: int
    size_bytes: int
    all_bytes: int  # sum of the declared bytes of all keys


class Uploads:
    """Store of uploads; every method is one transaction. An upload is visible to its own key only."""

    def __init__(self, database: Database, files: FileStore, disk_reserve_bytes: int) -> None:
        self._database = database
        self.files = files
        self._disk_reserve_bytes = disk_reserve_bytes

    def create(self, ask: UploadRequest, quota: UploadQuota, *, identifier: str | None = None) -> Upload:
        """Add an upload, whose bytes follow.

        Raises
        ------
        Conflict
            The declared bytes exceed the quota, or the id is taken.
        """
        now = self._database.now()
        row = UploadRow(
            id=identifier or new_id(),
            created_at=now,
            changed_at=now,
            key_id=actor().key_id,
            offset_bytes=0,
            state=UploadState.RECEIVING,
            **ask.model_dump(),
        )
        with self._database.write() as session:
            lock_files_of(session, _QUOTA_LOCK)
            refuse_taken(session, UploadRow, "upload", row.id)
            _check_quota(session, row, quota)
            session.add(row)
            announce(session, now, event_kinds.UPLOAD_CREATED, "upload", row.id)
            return read_upload(row)

    def get(self, upload_id: str) -> Upload:
        """Return one upload of the actor's key, or raise `NotFound`."""
        with self._database.read() as session:
            row = found(session, UploadRow, "upload", upload_id)
            if row.key_id != actor().key_id:
                raise NotFound("upload", upload_id)
            return read_upload(row)

    def check_room_for(self, size_bytes: int) -> int:
        """Check that an upload of this size leaves the disk its reserve, and room for the uploads already in progress.

        Returns
        -------
        int
            Bytes that must stay free in addition to the upload.

        Raises
        ------
        StorageFull, StorageUnavailable
            Less would be free, the data folder is not in its place, or the database could not write the rows of the
            upload.
        """
        self._database.check_writable()
        with self._database.read() as session:
            check_identity(session, self.files.folder)
        reserved_bytes = self._disk_reserve_bytes + self.promised_bytes()
        needed_by = f"an upload of {size_bytes} bytes, beside others that were begun and SAWMILL_DISK_RESERVE_BYTES,"
        self.files.check_room(reserved_bytes + size_bytes, needed_by=needed_by)
        return reserved_bytes

    def begin_part(self, upload_id: str, offset_bytes: int, *, part_bytes: int = 0) -> UploadPart:
        """Open an upload for its next part, which no other writer writes in this time; `close` must follow.

        Parameters
        ----------
        offset_bytes
            Offset of the part.
        part_bytes
            Declared length of the part; 0 if it is not declared.

        Raises
        ------
        NotFound, WrongOffset, Conflict
            There is no such upload, it continues at another offset, it is complete or would become too long, or another
            part is being received.
        StorageUnavailable
            The database does not answer, or could not write the part.
        """
        self._database.check_writable()
        self._awaited(upload_id, offset_bytes, part_bytes)  # before a file of this name is made
        part = UploadPart(self.files.unfinished(upload_id), upload_id, self._database)
        try:
            # Once more: another part may have ended just now.
            part.begin(self._awaited(upload_id, offset_bytes, part_bytes), reserve_bytes=self._disk_reserve_bytes)
        except BaseException:
            part.close()
            raise
        return part

    def received(self, upload_id: str) -> Received:
        """Link a complete upload under a second name; its use or `discard` must follow, as after a whole upload.

        Raises
        ------
        NotFound, Conflict
            There is no such upload, or it is not complete, or used.
        """
        upload = self.get(upload_id)
        if upload.state is not UploadState.COMPLETE:
            raise _not_usable(upload)
        again = self.files.second_name(
            self.files.unfinished(upload_id), size_bytes=upload.size_bytes, sha256=str(upload.sha256)
        )
        if again is None:
            raise _not_usable(self.get(upload_id))  # somebody has just used it, or deleted it
        return Received(again.path, again.size_bytes, again.sha256, upload_id)

    def promised_bytes(self) -> int:
        """Return the number of bytes that all uploads have still to receive."""
        missing = func.sum(UploadRow.size_bytes - UploadRow.offset_bytes)
        with self._database.read() as session:
            return int(session.scalar(select(missing).where(UploadRow.state == UploadState.RECEIVING)) or 0)

    def delete(self, upload_id: str, *, of_all_keys: bool = False) -> None:
        """Remove an upload and its file; resources that were made of it stay.

        Parameters
        ----------
        of_all_keys
            Whether the upload may belong to another key.

        Raises
        ------
        NotFound
            There is no such upload.
        """
        chosen = UploadRow.id == upload_id
        if not of_all_keys:
            chosen &= UploadRow.key_id.is_not_distinct_from(actor().key_id)
        self._remove(chosen, "deleted", or_else=NotFound("upload", upload_id))

    def remove_expired(self) -> Sequence[str]:
        """Remove uploads without a change for a day, and return their ids."""
        return self._remove(UploadRow.changed_at < self._database.now() - UPLOAD_KEPT, "expired")

    def _awaited(self, upload_id: str, offset_bytes: int, part_bytes: int) -> Upload:
        upload = self.get(upload_id)
        if upload.state is UploadState.USED:
            raise _not_usable(upload)
        if upload.state is UploadState.COMPLETE:
            raise Conflict("upload-complete", f"upload {upload_id!r} is complete: nothing more is missing")
        if upload.offset_bytes != offset_bytes:
            raise WrongOffset(upload, offset_bytes)
        missing = upload.size_bytes - upload.offset_bytes
        if part_bytes > missing:
            raise Conflict(
                "upload-too-long",
                f"upload {upload_id!r} lacks {missing} of {upload.size_bytes} bytes, but the part has {part_bytes}",
            )
        return upload

    def _remove(self, chosen: ColumnElement[bool], reason: str, *, or_else: NotFound | None = None) -> Sequence[str]:
        with self._database.write() as session:
            removed = session.scalars(delete(UploadRow).where(chosen).returning(UploadRow.id)).all()
            for upload_id in removed:
                announce_deleted(session, self._database.now(), upload_id, reason)
        if or_else is not None and not removed:
            raise or_else
        for upload_id in removed:
            self.files.remove(self.files.unfinished(upload_id))
        return removed


class WrongOffset(Conflict):
    """Refusal of a part that does not begin at the upload's offset."""

    def __init__(self, upload: Upload, offset_bytes: int) -> None:
        msg = (
            f"upload {upload.id!r} goes on at {upload.offset_bytes}, not at {offset_bytes}: {upload.offset_bytes} bytes"
        )
        super().__init__("wrong-offset", f"{msg} have come")
        self.expected_bytes = upload.offset_bytes


def use_up(session: Session, now: datetime, received: Received, kind: JobKind, subject_id: str) -> None:
    """Note an upload's use within the transaction that makes its resource; ignore a file that was not resumable."""
    if received.upload_id is None:
        return
    complete = (UploadRow.id == received.upload_id, UploadRow.state == UploadState.COMPLETE)
    used_by = f"/v1/{kind.plural}/{subject_id}"
    used = {"state": UploadState.USED, "used_by": used_by}
    if session.execute(update(UploadRow).where(*complete).values(used)).rowcount != 1:  # type: ignore[attr-defined]
        raise Conflict(
            "upload-used", f"upload {received.upload_id!r} has been used or deleted meanwhile: send it again"
        )
    announce(session, now, event_kinds.UPLOAD_USED, "upload", received.upload_id, detail={"used_by": used_by})


def _check_quota(session: Session, row: UploadRow, quota: UploadQuota) -> None:
    waiting = select(func.count(), func.coalesce(func.sum(UploadRow.size_bytes), 0))
    waiting = waiting.where(UploadRow.state != UploadState.USED)
    number, own_bytes = session.execute(waiting.where(UploadRow.key_id.is_not_distinct_from(row.key_id))).one()
    _, all_bytes = session.execute(waiting).one()
    advice = "use or delete one, or wait until it expires"
    if number >= quota.number:
        raise Conflict("upload-quota", f"{number} uploads of {actor().name} wait to be used: {advice}")
    for whose, waits, most in ((actor().name, own_bytes, quota.size_bytes), ("all keys", all_bytes, quota.all_bytes)):
        if waits + row.size_bytes > most:
            raise Conflict(
                "upload-quota",
                f"uploads of {whose} may have {most} bytes before they are used, and {waits} are taken: {advice}",
            )


def _not_usable(upload: Upload) -> Conflict:
    """Return the conflict for an upload that cannot be used; if it is complete, its file is gone."""
    if upload.state is UploadState.USED:
        return Conflict("upload-used", f"upload {upload.id!r} has become {upload.used_by}: send the file again")
    if upload.state is UploadState.COMPLETE:
        return lost(upload.id)
    if upload.offset_bytes == upload.size_bytes:
        msg = f"upload {upload.id!r} has come whole and was not yet summed up: send an empty part at its end"
        return Conflict("upload-incomplete", msg)
    msg = f"of upload {upload.id!r} {upload.offset_bytes} of {upload.size_bytes} bytes have come: send the rest first"
    return Conflict("upload-incomplete", msg)


def read_upload(row: UploadRow) -> Upload:
    """Return the upload of a row."""
    return Upload.of_row(row, expires_at=row.changed_at + UPLOAD_KEPT)


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
