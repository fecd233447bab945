"""The folders that contain uploads, results and files in progress.

incoming/                       uploads while they arrive; incoming.lock is held by the receiving process
unfinished/<id>                 uploads that can be resumed, until they are used
uploads/<plural>/<id>/          the file that was uploaded for a job of a kind, unchanged
<plural>/<id>/                  results of a job of a kind, by the plural of the subject (`contracts/jobs.py`)
attempts/<job>-<attempt>-<…>/   where only one attempt writes; renamed to one of the folders above at its success
attempts/<…>/kept/              checkpoints that its supervisor has not yet taken
attempts/<…>/work/              working folder of the process, where libraries write their own files; never published
kept/<job>/                     checkpoints, for the job's next attempt; until the job ends
removed/                        files that are being deleted
examples/                       files of which the examples were made, so that they are made once in a folder's life
identity                        a random id that the database has too (`folder_identity`)
watch.lock                      of the process that takes files from watched folders
serve.lock                      of the process that serves the folder (`workers/sole_service.py`); SQLite alone
sawmill.db.spare                reserve for a cancellation when the disk is full (`spare_room`)
last-backup.json                time and place of the last backup (`backups/taking.py`)
restoring                       mark of a restore that has not ended: no store opens (`backups/restoring.py`)

Files that are in no row are removed after a time (`leftovers`).
"""

import asyncio
import errno
import fcntl
import os
import re
import shutil
import threading
from collections.abc import AsyncIterable, Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple
from uuid import uuid4

import structlog

from sawmill_platform.contracts.attempts import checkpoints_of
from sawmill_platform.contracts.jobs import JobKind
from sawmill_platform.errors import (
    FolderUnavailable,
    NotFound,
    StorageFull,
    StorageMisconfigured,
    StorageUnavailable,
    disk_outage_reported,
    outage_of,
)
from sawmill_platform.files.upload_stream import Arriving, AsSent, Content, Received, check_free, receive_in_threads
from sawmill_platform.files.verified_results import VerifiedResults
from sawmill_platform.files.whole_files import flush

UPLOADED_FILE = "original"
_TEMPORARY = ("incoming", "removed")
_KEPT = "kept"
UNFINISHED = "unfinished"
EXAMPLES = "examples"
LAST_BACKUP = "last-backup.json"
RESTORING = "restoring"
IDENTITY = "identity"
_TRIAL_BYTES = 4096
SAFE_NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,63}")

_log = structlog.get_logger()


class Room(NamedTuple):
    """Free and total space of a disk."""

    free_bytes: int
    size_bytes: int


class FileStore:
    """Paths and safe writing below one data folder.

    Parameters
    ----------
    folder
        Folder on a single file system: publishing is a rename. Nothing is made before `make_folders`.
    """

    # Set by the store that has the rows with the digests.
    verified: VerifiedResults

    def __init__(self, folder: Path) -> None:
        self.folder = folder.absolute()

    def make_folders(self) -> None:
        """Make the folders of a data folder; only in a folder that is known to be the right one."""
        for name in (*_TEMPORARY, *(kind.plural for kind in JobKind.all()), "attempts", _KEPT, UNFINISHED):
            (self.folder / name).mkdir(parents=True, exist_ok=True)

    def check_there(self) -> None:
        """Check that a data folder is in its place, without a query to the database for its identity."""
        if read_identity(self.folder) is None:
            raise FolderUnavailable(f"the data folder {str(self.folder)!r} is missing, empty or not mounted")

    def check_writable(self) -> None:
        """Check that this user may write to the data folder.

        Raises
        ------
        FolderUnavailable
            The user may not, or the disk is read-only or fails.
        """
        refuse_read_only(self.folder)
        if not os.access(self.folder, os.W_OK | os.X_OK):
            raise FolderUnavailable(
                f"the data folder {str(self.folder)!r} cannot be written to by this user: check its owner"
            )

    def check_file(self, path: Path) -> None:
        """Check that a file exists that rows name.

        Raises
        ------
        FolderUnavailable
            The file is missing.
        """
        if not path.is_file():
            name = str(path.relative_to(self.folder))
            raise FolderUnavailable(
                f"the data folder {str(self.folder)!r} lacks the file {name!r}, which the database names: mount the "
                "right folder, or restore the file from a backup"
            )

    def upload(self, kind: JobKind, subject_id: str) -> Path:
        """Return the path of the file that was uploaded for a job of this kind."""
        return self.folder / "uploads" / kind.plural / _checked(subject_id) / UPLOADED_FILE

    def results(self, kind: JobKind, subject_id: str) -> Path:
        """Return the final folder of a job's subject."""
        return self.folder / kind.plural / _checked(subject_id)

    def result(self, kind: JobKind, subject_id: str, name: str) -> Path:
        """Return the path of the file that a job wrote, verified (`verified_results`): a library may open it.

        Raises
        ------
        NotFound
            The job has not written the file.
        DamagedResult
            The file is not the one that the job wrote.
        FolderUnavailable
            The data folder is not in its place.
        """
        path = self.unverified(kind, subject_id, name)
        self.verified.digest(path)
        return path

    def unverified(self, kind: JobKind, subject_id: str, name: str) -> Path:
        """Return the path that `result` returns, of a file that is sent and not opened by a library."""
        path = self.results(kind, subject_id) / name
        if not path.is_file():
            self.check_there()
            raise NotFound(name.replace(".", "-"), subject_id)
        return path

    def kept(
        self, kind: JobKind, subject_id: str, name: str, make: Callable[[], bytes], *, one_at_a_time: threading.Lock
    ) -> Path:
        """Return a file of the subject's folder that is made at the first request; the file is complete or missing.

        An existing file is returned without waiting; a missing one is made once, however many callers request it.

        Raises
        ------
        NotFound
            The folder was removed while the file was made.
        StorageFull
            The disk is full.
        """
        path = self.results(kind, subject_id) / name
        if path.is_file():
            return path
        with one_at_a_time:
            if not path.is_file():
                content = make()
                made = self.receive([content], max_bytes=len(content))
                try:
                    made.path.rename(path)
                except FileNotFoundError:
                    self.discard(made)
                    raise NotFound(name.replace(".", "-"), subject_id) from None
                flush(path.parent)
        return path

    def make_attempt_folder(self, job_id: str, attempt: int) -> Path:
        """Make an empty folder that only this attempt writes and removes; folders of other attempts are not touched."""
        path = self.folder / "attempts" / f"{_checked(job_id)}-{attempt}-{uuid4().hex}"
        with disk_outage_reported("a job's output folder"):
            path.mkdir()
        return path

    def kept_with(self, job_id: str) -> Path:
        """Return the folder with the checkpoints of earlier attempts at a job; the folder may be missing."""
        return self.folder / _KEPT / _checked(job_id)

    def keep(self, output: Path, job_id: str, names: Sequence[str]) -> None:
        """Move an attempt's checkpoints to its job, in place of older ones; a missing checkpoint was moved before."""
        folder = self.kept_with(job_id)
        with disk_outage_reported("keeping a job's progress"):
            folder.mkdir(exist_ok=True)
            for name in names:
                checkpoint = checkpoints_of(output) / _checked(name)
                if checkpoint.is_file() and not checkpoint.is_symlink():
                    with suppress(FileNotFoundError):
                        checkpoint.rename(folder / name)
                elif os.path.lexists(checkpoint):
                    raise NotFound("file", name)
            flush(folder)

    def publish(self, output: Path, final: Path) -> None:
        """Rename an attempt's flushed output folder to its final name; an older folder of that name is removed."""
        with disk_outage_reported("publishing a result"):
            self._remove(final)
            output.rename(final)
            flush(final.parent)

    def remove(self, path: Path) -> None:
        """Remove a file or folder in one step, as seen by other processes; a missing one is ignored.

        Files that cannot be removed from a failing or read-only disk are leftovers: housekeeping removes them later.
        """
        try:
            self._remove(path)
        except OSError as error:
            outage = outage_of(error, "removing files")
            if outage is None:
                raise
            _log.warning("left-for-housekeeping", name=str(path.relative_to(self.folder)), reason=str(outage))

    def _remove(self, path: Path) -> None:
        parting = self.set_aside(path)
        if parting is not None:
            self.delete(parting)

    def set_aside(self, path: Path) -> Path | None:
        """Move a file or folder away from its name; `delete` must follow."""
        parting = self.folder / "removed" / uuid4().hex
        try:
            path.rename(parting)
        except FileNotFoundError:
            return None
        except OSError as error:
            if not isinstance(outage_of(error, "removing files"), StorageFull):
                raise
            return path  # a full disk may have no room for one more name: then the files are deleted one by one
        return parting

    def delete(self, path: Path) -> None:
        """Delete a file or folder that was set aside."""
        if not path.is_dir():
            path.unlink()
            return
        try:
            shutil.rmtree(path)
        except (RecursionError, PermissionError):  # made by somebody who wanted to prevent the removal
            # The folder may have any depth, and folders in it may be closed to their owner.
            path.chmod(0o700)
            folders = [path]
            while folders:
                folder = folders.pop()
                with os.scandir(folder) as found:
                    entries = list(found)
                for entry in entries:
                    if entry.is_dir(follow_symlinks=False):
                        Path(entry.path).chmod(0o700)
                        folders.append(Path(entry.path).rename(self.folder / "removed" / uuid4().hex))
                    else:
                        Path(entry.path).unlink()
                folder.rmdir()

    def room(self) -> Room:
        """Return the space on the data folder's disk, or raise `FolderUnavailable`."""
        self.check_there()
        usage = shutil.disk_usage(self.folder)
        return Room(free_bytes=usage.free, size_bytes=usage.total)

    def check_room(self, reserve_bytes: int, *, needed_by: str) -> None:
        """Check that files can be written into the folder of incoming uploads, as the function `check_room` does."""
        check_room(self.folder / "incoming", reserve_bytes, needed_by=needed_by)

    def keep_upload(self, received: Received, kind: JobKind, subject_id: str) -> None:
        """Move an upload to its owner."""
        self.check_there()
        path = self.upload(kind, subject_id)
        with disk_outage_reported("storing the upload"):
            path.parent.mkdir(parents=True, exist_ok=True)
            try:
                received.path.rename(path)
            except FileNotFoundError as error:
                raise StorageUnavailable("the upload stood still until it was given up: send it again") from error
            flush(path.parent)
            flush(path.parent.parent)

    def second_name(self, file: Path, *, size_bytes: int, sha256: str) -> Received | None:
        """Link a file as an upload without an owner, without a copy; None: the file is gone."""
        path = self.folder / "incoming" / uuid4().hex
        with disk_outage_reported("the upload"):
            try:
                path.hardlink_to(file)
            except FileNotFoundError:
                self.check_there()
                return None
        return Received(path, size_bytes, sha256)

    def unfinished(self, upload_id: str) -> Path:
        """Return the path of an upload that can be resumed."""
        return self.folder / UNFINISHED / _checked(upload_id)

    def remove_upload(self, kind: JobKind, subject_id: str) -> None:
        """Remove an uploaded file."""
        self.remove(self.upload(kind, subject_id).parent)

    def discard(self, received: Received) -> None:
        """Remove an upload that no row uses."""
        received.path.unlink(missing_ok=True)

    @contextmanager
    def receiving(self) -> Iterator[None]:
        """Receive uploads during the block; if no other service does, first remove the files that a killed one left."""
        with (self.folder / "incoming.lock").open("w") as lock:
            with suppress(BlockingIOError):
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                for left in (self.folder / "incoming").iterdir():
                    left.unlink(missing_ok=True)
            fcntl.flock(lock, fcntl.LOCK_SH)
            yield

    def receive(self, chunks: Iterable[bytes], *, max_bytes: int) -> Received:
        """Write an upload to the disk as it arrives.

        Parameters
        ----------
        chunks
            The file's bytes.
        max_bytes
            The largest upload allowed.

        Returns
        -------
        Received
            The complete, flushed upload; `keep_upload` or `discard` must follow.

        Raises
        ------
        UploadTooLarge, StorageFull
            The upload is too large or the disk is full. No file is left, nor if the iterable raises.
        """
        upload = self._arriving(max_bytes, reserve_bytes=0)
        try:
            with disk_outage_reported("the upload"):
                for chunk in chunks:
                    upload.write(chunk)
            return upload.finish(AsSent())
        except BaseException:
            upload.abandon()
            raise

    async def receive_stream(
        self, chunks: AsyncIterable[bytes], *, max_bytes: int, reserve_bytes: int = 0, content: Content | None = None
    ) -> Received:
        """Write a request's body as `receive` does; an upload that is broken off leaves nothing behind.

        Parameters
        ----------
        reserve_bytes
            Bytes that must stay free on the disk.
        content
            Decoder of the body; null: the body is the file's bytes.
        """
        arriving = await asyncio.to_thread(self._arriving, max_bytes, reserve_bytes)
        return await receive_in_threads(arriving, chunks, content or AsSent())

    def _arriving(self, max_bytes: int, reserve_bytes: int) -> Arriving:
        return Arriving(self.folder / "incoming" / uuid4().hex, max_bytes=max_bytes, reserve_bytes=reserve_bytes)


def read_identity(folder: Path) -> str | None:
    """Return the identity in a folder; None: there is none, for example if a share is not mounted."""
    with disk_outage_reported("reading its identity"):
        try:
            return (folder / IDENTITY).read_text(errors="replace").strip()
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (IsADirectoryError, PermissionError) as error:
            raise FolderUnavailable(
                f"the file {IDENTITY!r} of the data folder {str(folder)!r} cannot be read by this user "
                f"({error.strerror}): check its owner"
            ) from error


def is_read_only(folder: Path) -> bool:
    """Return whether a folder's disk is read-only now; a file system makes itself read-only when its disk has errors.

    Raises
    ------
    FolderUnavailable
        The folder is missing, or its disk fails.
    """
    with disk_outage_reported("looking at its disk"):
        if os.statvfs(folder).f_flag & os.ST_RDONLY:
            return True
    # ext4 does not report this by the flag any more, and refuses every new file: also one without a name.
    try:
        os.close(os.open(folder, os.O_WRONLY | os.O_TMPFILE, 0o600))
    except OSError as error:
        return error.errno == errno.EROFS
    return False


def refuse_read_only(folder: Path) -> None:
    """Refuse a folder on a disk that cannot be written to."""
    if is_read_only(folder):
        raise FolderUnavailable(
            f"the data folder {str(folder)!r} is on a disk that is read-only now: look for the disk's errors in the "
            "system's log, and mount it for writing again"
        )


def refuse_half_restored(folder: Path) -> None:
    """Refuse a data folder whose restore was interrupted.

    Raises
    ------
    StorageMisconfigured
        The folder's restore was interrupted.
    """
    if (folder / RESTORING).exists():
        raise StorageMisconfigured(
            f"a restore into {str(folder)!r} goes on, or was ended before its end: wait for it, or give it once more"
        )


def work_of(output: Path) -> Path:
    """Return the working folder of an attempt's process; files that libraries write there are no results."""
    return output / "work"


def check_room(folder: Path, reserve_bytes: int, *, needed_by: str) -> None:
    """Check that files can be written into a folder of ours, by writing one.

    Parameters
    ----------
    reserve_bytes, needed_by
        Bytes that must be free, and the purpose of the space, for the sentence.

    Raises
    ------
    StorageFull
        Less than `reserve_bytes` is free, or there is no room for a small file.
    FolderUnavailable
        The folder is missing, or its disk fails or is read-only.
    """
    check_free(folder, reserve_bytes, needed_by=needed_by)
    trial = folder / uuid4().hex
    with disk_outage_reported("a trial"):
        try:
            trial.write_bytes(bytes(_TRIAL_BYTES))
        finally:
            trial.unlink(missing_ok=True)


def flush_tree(folder: Path) -> None:
    """Make a folder and the files in it durable."""
    with disk_outage_reported("a result"):
        for path in folder.rglob("*"):
            flush(path)
        flush(folder)


def _checked(identifier: str) -> str:
    """Return a name, or raise `NotFound` if it could lead out of a folder."""
    if not SAFE_NAME.fullmatch(identifier):
        raise NotFound("file", identifier)
    return identifier
