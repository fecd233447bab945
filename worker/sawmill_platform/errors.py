"""Errors of the storage.

StorageError
├── NotFound            no such resource, or it has no such file
├── Conflict            the resource's state forbids it
│   └── Busy            for a moment only
├── Invalid             a value that cannot be right, such as a cron expression of four fields
├── QueueFull           the largest number of jobs is waiting
├── UploadTooLarge      more bytes than allowed
├── Damaged             other bytes than declared
├── InvalidOutput       other files than the kind of job leaves
├── DamagedResult       a stored result that is not as its job wrote it
├── BackupRefused       no backup or restore is possible now
├── LeaseLost           another attempt owns the job
├── StorageFull         no room left on the disk
└── StorageUnavailable  the database does not answer, or the data folder cannot be used
    ├── FolderUnavailable       the data folder is not in its place, or its disk fails or is read-only
    └── StorageMisconfigured    the database will not answer before its settings are changed
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import ParamSpec, TypeVar

from sawmill_platform.files.whole_files import DISK_AWAY, DISK_FULL

Asked = ParamSpec("Asked")
Found = TypeVar("Found")


class StorageError(Exception):
    """Root of the storage's errors; `code` is stable, for programs."""

    code = "storage-error"


class NotFound(StorageError):  # noqa: N818 - an outcome's name, as HTTP has it
    """There is no resource of this kind with this id."""

    def __init__(self, kind: str, identifier: str) -> None:
        super().__init__(f"there is no {kind} {identifier!r}")
        self.kind = kind
        self.code = f"{kind}-not-found"


def if_found(get: Callable[Asked, Found], *named: Asked.args, **options: Asked.kwargs) -> Found | None:
    """Return what a function returns; None where it raises `NotFound`, as for what was deleted since."""
    try:
        return get(*named, **options)
    except NotFound:
        return None


class Conflict(StorageError):  # noqa: N818
    """The resource's state forbids the request."""

    def __init__(self, code: str, sentence: str) -> None:
        super().__init__(sentence)
        self.code = code


class Busy(Conflict):
    """Another request is using the resource; a repeated request in a moment may succeed."""


class Invalid(StorageError):  # noqa: N818
    """The value cannot be right in any state."""

    def __init__(self, code: str, sentence: str) -> None:
        super().__init__(sentence)
        self.code = code


class QueueFull(StorageError):  # noqa: N818
    """The largest number of jobs is waiting, in all or of one key."""

    code = "queue-full"

    def __init__(self, sentence: str, retry_after_s: int) -> None:
        super().__init__(sentence)
        self.retry_after_s = retry_after_s


class UploadTooLarge(StorageError):  # noqa: N818
    """An upload exceeded its limit; nothing was kept."""

    code = "upload-too-large"

    def __init__(self, limit_bytes: int) -> None:
        super().__init__(f"the upload is larger than the {limit_bytes} bytes allowed")


class Damaged(StorageError):  # noqa: N818
    """The upload's bytes differ from the declared ones; nothing was kept."""

    code = "digest-mismatch"


class InvalidOutput(StorageError):  # noqa: N818
    """An attempt left other files than jobs of the kind leave: nothing is published."""

    code = "invalid-result"


class DamagedResult(StorageError):  # noqa: N818
    """A file of ours that is damaged, or another one than the job wrote; `reason` says what is wrong with it."""

    code = "result-damaged"

    def __init__(self, name: str, reason: str) -> None:
        sentence = f"{name} is damaged, or is another file than the job wrote ({reason})"
        super().__init__(f"{sentence}: restore it from a backup, or ask for it again")
        self.reason = reason


class BackupRefused(StorageError):  # noqa: N818
    """A backup or a restore is not possible now; the sentence says what to change."""


class LeaseLost(StorageError):  # noqa: N818
    """Another attempt owns the job now, or the job has ended: the attempt's work no longer counts."""

    code = "lease-lost"

    def __init__(self, job_id: str, attempt: int) -> None:
        super().__init__(f"attempt {attempt} no longer holds job {job_id!r}")


class StorageFull(StorageError):  # noqa: N818
    """The disk is full; nothing half-written was left behind."""

    code = "storage-full"


class StorageUnavailable(StorageError):  # noqa: N818
    """The database does not answer, or the data folder cannot be used; a later retry may succeed."""

    code = "storage-unavailable"


class FolderUnavailable(StorageUnavailable):
    """The data folder is missing, empty or another one, or its disk fails or is read-only."""


class StorageMisconfigured(StorageUnavailable):
    """The database refuses its user, or there is no database of this name: waiting does not help."""


def outage_of(error: OSError, doing: str) -> StorageFull | FolderUnavailable | None:
    """Return the outage of a disk that an error of the system means; None if the error has another cause.

    Parameters
    ----------
    error
        Error of a call that read or wrote in the data folder.
    doing
        Name of the failed work, for the sentence.
    """
    if error.errno in DISK_FULL:
        return StorageFull(f"the disk is full: {doing} was given up; free some space in the data folder and try again")
    if error.errno in DISK_AWAY:
        reason = f"the data folder cannot be used ({error.strerror}): {doing} was given up"
        return FolderUnavailable(f"{reason}; look at its disk or mount in the system's log")
    return None


@contextmanager
def disk_outage_reported(doing: str) -> Iterator[None]:
    """Turn a disk that is full, fails, is read-only or away into `StorageFull` or `FolderUnavailable`.

    In the block a file is missing only if a folder of ours is missing: that is an outage too.

    Parameters
    ----------
    doing
        Name of the failed work, for the sentence.
    """
    try:
        yield
    except FileNotFoundError as error:
        msg = f"the data folder is not as it was ({str(error.filename)!r} is missing): {doing} was given up; look at "
        raise FolderUnavailable(f"{msg}its disk or mount in the system's log") from error
    except OSError as error:
        outage = outage_of(error, doing)
        if outage is None:
            raise
        raise outage from error
