"""Watched folders: complete files of scanners that can only write files become scans (docs/do/watched-folder.md).

A file is in one of these places, and goes from one to the next by a rename:

    NAME                    its scanner writes it
    taken/ID/NAME           it is being copied; ID is the id that its scan will have
    taken/ID.TIME/NAME      its scan was made; TIME is the file's last change, ns, when it was copied
    refused/DAY/NAME        it was refused, for the reason in NAME.reason.txt; what the service has read is removed

A table holds an id once: a file makes one scan, however often its taker is killed, and by whichever process it is taken
next. Folders are opened one within the other and without links: a user who can write into one leads nowhere else.
"""
# ruff: noqa: PTH208 - lists what is in an open folder

import errno
import hashlib
import os
import re
import stat
import threading
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO
from uuid import uuid4

import structlog

from sawmill_contracts.scans import ScanSpec, ScanState
from sawmill_contracts.watched_folders import WatchedFolder
from sawmill_platform.contracts.given import shown
from sawmill_platform.errors import UploadTooLarge
from sawmill_platform.files.upload_stream import PART_BYTES
from sawmill_platform.files.whole_files import open_regular
from sawmill_platform.ledger.events import Actor, acting_as
from sawmill_platform.settings import LargestUpload
from sawmill_platform.workers.sole_service import HeldByAnother, kernel_lock
from sawmill_store.store import Store

TAKEN, REFUSED, DONE, REASON = "taken", "refused", ".done", ".reason.txt"
# Number of files taken at a time: other files stay visible in the folder, and the queue stays short.
MOST_TAKEN = 8
# Bytes reserved for additions to a name; file systems allow 255 bytes.
LONGEST_NAME_BYTES = 200
# Time, s, until a file that failed is tried again, and until a `.done` file that came after its file is removed.
WAIT_S = 60.0
_UNFINISHED = (".tmp", ".part", ".filepart", ".crdownload", "~")
_TAKING = re.compile(r"([0-9a-f]{32})(?:\.([0-9]{1,20}))?")
# Time for which an orderly stop waits for a copy to be given up, s.
_STOP_S = 2.0


class WatchedFolders:
    """Taker of the files in the watched folders of all scanners; of several processes on one store one takes."""

    def __init__(self, store: Store, stop: threading.Event, monotonic: Callable[[], float]) -> None:
        self._store = store
        self._stop = stop
        self._monotonic = monotonic
        self._folders: dict[str, _Folder] = {}
        self._lock = ExitStack()
        self._is_taker = False

    def look(self) -> None:
        """Inspect each folder in a separate thread."""
        if not self._is_taker:
            try:
                self._lock.enter_context(kernel_lock(self._store.files.folder / "watch.lock"))
            except HeldByAnother:
                return
            self._is_taker = True
        for scanner_id, settings in self._store.scanners.watched_folders().items():
            if scanner_id not in self._folders:
                self._folders[scanner_id] = _Folder(self._store, scanner_id, self._stop, self._monotonic)
            self._folders[scanner_id].look(settings)

    def wait(self, limit_s: float = _STOP_S) -> None:
        """Wait for the end of the present inspections, at most this number of seconds for each folder."""
        for folder in self._folders.values():
            folder.wait(limit_s)

    def close(self) -> None:
        """Let another process take files, after the stop."""
        self.wait()
        self._lock.close()


class _Refused(Exception):  # noqa: N818 - an outcome
    """A file that a person must check; the message is the reason."""

    def __init__(self, code: str, reason: str) -> None:
        super().__init__(reason)
        self.code = code


@dataclass(frozen=True)
class _Look:
    """Size in bytes and last change in ns of a file, since when they are the same, and at how many inspections."""

    signature: tuple[int, int]
    since_s: float
    number: int


class _Folder:
    """Watched folder of one scanner."""

    def __init__(self, store: Store, scanner_id: str, stop: threading.Event, monotonic: Callable[[], float]) -> None:
        self._store = store
        self._scanner_id = scanner_id
        self._stop = stop
        self._monotonic = monotonic
        self._thread: threading.Thread | None = None
        self._looks: dict[str, _Look] = {}
        # What was logged of a file, and when it is tried again.
        self._said: dict[str, str] = {}
        self._again_s: dict[str, float] = {}

    def look(self, watched: WatchedFolder) -> None:
        """Start an inspection in a thread, unless one is running: a silent share keeps no other work waiting."""
        if self._thread is None or not self._thread.is_alive():
            self._thread = threading.Thread(target=self._look, args=(watched,), name="watched", daemon=True)
            self._thread.start()

    def wait(self, limit_s: float) -> None:
        """Wait for the end of the inspection."""
        if self._thread is not None:
            self._thread.join(limit_s)

    def _look(self, watched: WatchedFolder) -> None:
        """Process taken files further, then take complete ones, the oldest first."""
        acting = acting_as(Actor(f"watched folder of {self._scanner_id}", of_service=True))
        with acting, self._reported(watched.folder), ExitStack() as stack:
            here = _opened_below(stack, self._store.settings.watch_folders, Path(watched.folder))
            taken = stack.enter_context(_made(TAKEN, here))
            for name in sorted(os.listdir(taken)):
                self._bring_on(watched, here, taken, name)
            names, on_way = set(os.listdir(here)), os.listdir(taken)
            for name in self._complete(watched, here, names)[: max(0, MOST_TAKEN - len(on_way))]:
                with self._reported(name), suppress(FileNotFoundError):
                    on_way.append(self._take(here, taken, name))
                    self._bring_on(watched, here, taken, on_way[-1])
            for notes in (self._looks, self._said, self._again_s):
                for gone in notes.keys() - {watched.folder, *names, *on_way}:
                    notes.pop(gone)

    @contextmanager
    def _reported(self, about: str) -> Iterator[None]:
        """Log once why a file or the folder waits; the others continue."""
        try:
            yield
            self._said.pop(about, None)
        except Exception as error:  # noqa: BLE001 - whatever is wrong with one file says nothing of the next one
            self._again_s[about] = self._monotonic() + WAIT_S
            self._say("watched-waits", about, str(error) or repr(error))

    def _say(self, event: str, about: str, reason: str) -> None:
        if self._said.get(about) != reason:
            self._said[about] = reason
            structlog.get_logger().warning(event, scanner_id=self._scanner_id, about=about, reason=reason)

    def _is_due(self, name: str) -> bool:
        return self._monotonic() >= self._again_s.get(name, 0.0)

    # Complete files

    def _complete(self, watched: WatchedFolder, here: int, names: set[str]) -> list[str]:
        """Return the names of complete files, those that changed first before the others."""
        complete: dict[str, int] = {}
        for name in sorted(names):
            if not self._is_due(name) or not self._is_looked_at(watched, here, names, name):
                continue
            with self._reported(name), suppress(FileNotFoundError):
                look = self._looked(here, name)
                if name.endswith(DONE):
                    if self._has_stood(look, max(WAIT_S, watched.still_for_s or 0.0)):
                        os.unlink(name, dir_fd=here)
                elif _is_marked(here, names, name, look) or (
                    watched.still_for_s is not None and look.signature[0] and self._has_stood(look, watched.still_for_s)
                ):
                    complete[name] = look.signature[1]
        return sorted(complete, key=complete.__getitem__)

    def _is_looked_at(self, watched: WatchedFolder, here: int, names: set[str], name: str) -> bool:
        """Return whether a name belongs to a file to take, or to a mark whose file was taken before the mark came."""
        if name.startswith(".") or name.lower().endswith(_UNFINISHED) or name in {TAKEN, REFUSED}:
            return False
        is_mark = name.endswith(DONE)
        if is_mark and name.removesuffix(DONE) in names:
            return False
        reason = None
        if not _is_file(here, name):
            reason = "it is a link or no file: a scan of several files is one file, as a ZIP"
        elif watched.files_named(name.removesuffix(DONE)) is None:
            reason = "no pattern matches its name"
        elif len(os.fsencode(name)) > LONGEST_NAME_BYTES:
            reason = f"its name has more than {LONGEST_NAME_BYTES} bytes"
        if reason is not None and not is_mark:
            self._say("watched-left-alone", name, reason)
        return reason is None

    def _looked(self, folder: int, name: str, key: str | None = None) -> _Look:
        """Open a file, so that a network share is asked, and count how often it was the same."""
        with open_regular(name, folder) as file:
            signature = _signature(file)
        before = self._looks.get(key or name)
        if before is None or before.signature != signature:
            before = _Look(signature, self._monotonic(), 0)
        look = self._looks[key or name] = replace(before, number=before.number + 1)
        return look

    def _has_stood(self, look: _Look, still_for_s: float) -> bool:
        return look.number > 1 and self._monotonic() - look.since_s >= still_for_s

    # The way of a file

    def _take(self, here: int, taken: int, name: str) -> str:
        """Move a complete file into a new folder, and return the folder's name, the id of the scan."""
        scan_id = uuid4().hex
        os.mkdir(scan_id, dir_fd=taken)
        with _opened(scan_id, taken) as inside:
            try:
                os.rename(name, name, src_dir_fd=here, dst_dir_fd=inside)
            except OSError:  # on a Windows share its writer may still have it open
                os.rmdir(scan_id, dir_fd=taken)
                raise
            _flush(inside, taken, here)
        if _is_file(here, name + DONE):
            os.unlink(name + DONE, dir_fd=here)
        self._looks[scan_id] = self._looks.pop(name)
        return scan_id

    def _bring_on(self, watched: WatchedFolder, here: int, taken: int, name: str) -> None:
        """Process a taken file as far as possible now."""
        if not self._is_due(name):
            return
        with self._reported(name), suppress(FileNotFoundError):
            match = _TAKING.fullmatch(name)
            if match is None:
                msg = f"{TAKEN}/{name} is not of this program: move what it holds back, and remove it"
                raise ValueError(msg)
            scan_id, changed_ns = match.groups()
            with _opened(name, taken) as inside:
                files = os.listdir(inside)  # none if its taker was killed before the file came, or after it went
                if len(files) > 1:
                    msg = f"{TAKEN}/{name} holds more than one file: move them back, and remove it"
                    raise ValueError(msg)
                for file in files:
                    try:
                        if changed_ns is None:
                            copied_ns = self._made_scan(watched, inside, file, scan_id)
                            if copied_ns is not None:
                                os.rename(name, f"{scan_id}.{copied_ns}", src_dir_fd=taken, dst_dir_fd=taken)
                            return
                        if not self._was_read(inside, file, scan_id, int(changed_ns)):
                            return
                        os.unlink(file, dir_fd=inside)
                    except _Refused as refused:
                        self._refuse(here, inside, file, scan_id, refused)
            os.rmdir(name, dir_fd=taken)

    def _made_scan(self, watched: WatchedFolder, inside: int, file: str, scan_id: str) -> int | None:
        """Copy a file and make its scan; return the copy's last change, ns, or None while the file is written to."""
        if self._store.scans.several([scan_id]):
            return 0  # the taker was killed before the folder was renamed: in the end the contents are compared
        files = watched.files_named(file)
        if files is None:
            raise ValueError("it was taken, and no pattern matches its name any more")
        fields = files.model_dump(include=set(ScanSpec.model_fields))
        spec = ScanSpec(**fields, scanner_id=self._scanner_id, name=shown(file)[:200].strip() or "scan")
        self._store.scans.check(spec)
        look = self._looked(inside, file, key=scan_id)
        if look.number == 1:
            return None
        if not look.signature[0]:
            raise _Refused("empty-file", "the file is empty, though it is marked as complete")
        self._store.uploads.check_room_for(look.signature[0])
        with self._store.files.receiving(), open_regular(file, inside) as source:
            try:
                received = self._store.files.receive(self._pieces(source), max_bytes=LargestUpload().max_upload_bytes)
            except UploadTooLarge as error:
                raise _Refused(error.code, str(error)) from error
            if _signature(source) != look.signature:
                self._store.files.discard(received)
                return None
            scan = self._store.scans.accept(spec, received, scan_id=scan_id, priority=files.priority)
        structlog.get_logger().info("watched-taken", scanner_id=self._scanner_id, name=file, scan_id=scan.id)
        return look.signature[1]

    def _pieces(self, source: BinaryIO) -> Iterator[bytes]:
        while piece := source.read(PART_BYTES):
            if self._stop.is_set():
                raise InterruptedError("the worker stops: it is copied by another one")
            yield piece

    def _was_read(self, inside: int, file: str, scan_id: str, copied_ns: int) -> bool:
        """Return whether the scan was read from what the file still is; False: it is being read."""
        scan = self._store.scans.several([scan_id]).get(scan_id)
        if scan is None:
            raise _Refused("scan-not-found", f"scan {scan_id} was deleted before its file was removed")
        if scan.state is ScanState.INGESTING:
            return False
        if scan.state is ScanState.REFUSED:
            failure = self._store.jobs.get(scan.job_id).failure
            raise _Refused("cancelled" if failure is None else failure.code, scan.reason or "it could not be read")
        with open_regular(file, inside) as source:
            is_untouched = _signature(source) == (scan.size_bytes, copied_ns)
            if is_untouched or hashlib.file_digest(source, "sha256").hexdigest() == scan.sha256:
                return True
        raise _Refused("file-changed", f"it was written to after it was taken; scan {scan_id} has what it was then")

    def _refuse(self, here: int, inside: int, file: str, scan_id: str, refused: _Refused) -> None:
        """Move a file to the refused ones; the reason is written first, so that no refused file is without it."""
        with _made(REFUSED, here) as every_day, _made(datetime.now(UTC).date().isoformat(), every_day) as folder:
            path = Path(file)
            target = f"{path.stem}-{scan_id[:8]}{path.suffix}" if _is_file(folder, file) else file
            _write(folder, target + REASON, f"{refused}\ncode: {refused.code}\nscan: {scan_id}\n")
            os.rename(file, target, src_dir_fd=inside, dst_dir_fd=folder)
            _flush(folder, inside)
        details = {"name": file, "scan_id": scan_id, "code": refused.code, "reason": str(refused)}
        structlog.get_logger().warning("watched-refused", scanner_id=self._scanner_id, **details)


# Files within open folders


def _opened_below(stack: ExitStack, roots: Sequence[Path], folder: Path) -> int:
    """Open a folder below one of the allowed ones, each part of the path within the one before."""
    root = next((each for each in roots if folder.is_relative_to(each)), None)
    if root is None:
        raise ValueError(f"SAWMILL_WATCH_FOLDERS does not allow {folder} any more")
    descriptor = stack.enter_context(_opened(str(root.resolve())))
    for part in folder.relative_to(root).parts:
        descriptor = stack.enter_context(_opened(part, descriptor))
    return descriptor


@contextmanager
def _opened(name: str, within: int | None = None) -> Iterator[int]:
    descriptor = os.open(name, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW, dir_fd=within)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


@contextmanager
def _made(name: str, within: int) -> Iterator[int]:
    """Open a folder, which is made with the permissions of the one that holds it if it is missing."""
    made = False
    with suppress(FileExistsError):
        os.mkdir(name, dir_fd=within)
        made = True
    with _opened(name, within) as descriptor:
        if made:
            _share(descriptor, within, 0o777)
            _flush(within)
        yield descriptor


def _share(descriptor: int, within: int, mask: int) -> None:
    """Permit what the folder permits, whatever the service's own files permit; some shares accept no permissions."""
    with suppress(PermissionError):
        os.fchmod(descriptor, os.fstat(within).st_mode & mask)


def _write(folder: int, name: str, text: str) -> None:
    """Write a small file in place of any other with this name."""
    with suppress(FileNotFoundError):
        os.unlink(name, dir_fd=folder)
    descriptor = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600, dir_fd=folder)
    with os.fdopen(descriptor, "wb") as file:
        _share(descriptor, folder, 0o666)
        file.write(text.encode(errors="replace"))
        file.flush()
        os.fsync(descriptor)


def _is_file(folder: int, name: str) -> bool:
    try:
        return stat.S_ISREG(os.stat(name, dir_fd=folder, follow_symlinks=False).st_mode)
    except FileNotFoundError:
        return False


def _is_marked(folder: int, names: Collection[str], name: str, look: _Look) -> bool:
    """Return whether NAME.done is there; a mark older than the file belongs to an earlier file of the name."""
    if name + DONE not in names or not _is_file(folder, name + DONE):
        return False
    return os.stat(name + DONE, dir_fd=folder, follow_symlinks=False).st_mtime_ns >= look.signature[1]


def _signature(file: BinaryIO) -> tuple[int, int]:
    status = os.fstat(file.fileno())
    return status.st_size, status.st_mtime_ns


def _flush(*folders: int) -> None:
    """Make the names in folders durable, if their file system supports that."""
    for folder in folders:
        try:
            os.fsync(folder)
        except OSError as error:
            if error.errno not in {errno.EINVAL, errno.ENOTSUP}:
                raise
