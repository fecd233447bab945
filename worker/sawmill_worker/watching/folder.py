"""A watched folder: complete files are taken, and each taken file is brought to its destination."""

import errno
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

from sawmill_platform.files.whole_files import DISK_AWAY, DISK_FULL
from sawmill_platform.workers.kernel_lock import HeldByAnother, kernel_lock
from sawmill_worker.watching.backoff import Backoff
from sawmill_worker.watching.durable import FileChanged, make_folder, signature
from sawmill_worker.watching.fates import Fates
from sawmill_worker.watching.looks import Looks
from sawmill_worker.watching.news import News
from sawmill_worker.watching.sending import FileSending, ShowProgress
from sawmill_worker.watching.service import Json, Refusal, RequestFails, Service
from sawmill_worker.watching.settings import WatchedFolder
from sawmill_worker.watching.stopping import Stop
from sawmill_worker.watching.takings import Taking, Takings

LOCK = "watch.lock"
# Number of files taken at a time: other files stay visible in the folder, and the service's queue stays short.
MOST_TAKEN = 8
# Codes after which a file is sent again: the received data differ from the file, or the service has lost the data.
_ANOTHER_UPLOAD = frozenset({"digest-mismatch", "upload-lost"})


class FolderWaits(Exception):  # noqa: N818 - a state that lasts until a person acts
    """The folder cannot be watched now, or the service refuses the folder's settings."""

    def __init__(self, code: str, sentence: str) -> None:
        super().__init__(sentence)
        self.code = code


class _FileRefused(Exception):  # noqa: N818 - an outcome
    """A file is unusable, and a person must check it."""

    def __init__(self, code: str, reason: str) -> None:
        super().__init__(reason)
        self.code = code


class _FileWaits(Exception):  # noqa: N818 - a temporary state
    """A file cannot be processed now, while other files can."""

    def __init__(self, code: str, reason: str) -> None:
        super().__init__(reason)
        self.code = code


class Folder:
    """A folder from which only this process takes files, while it is `locked`."""

    def __init__(
        self, settings: WatchedFolder, service: Service, news: News, stop: Stop, show_progress: ShowProgress
    ) -> None:
        self.settings = settings
        self.counts: Counter[str] = Counter()
        self.looks = Looks(settings, news)
        self._service = service
        self._news = news
        self._stop = stop
        self._takings = Takings(settings.path, settings.taken_folder)
        self._sending = FileSending(settings, self._takings, service, stop, show_progress)
        self._fates = Fates(settings, self._takings)
        self._looking = False
        self._on_way: list[Taking] = []
        # Waiting times of takings at which the service fails.
        self._backoffs: defaultdict[str, Backoff] = defaultdict(Backoff)

    @property
    def name(self) -> str:
        """Name of the folder in the log."""
        return self.settings.folder

    @contextmanager
    def locked(self) -> Iterator[TextIO]:
        """Make the folders that it needs, and lock the folder for the block.

        Raises
        ------
        FolderWaits
            Another process watches the folder; the sentence has the id of the process.
        OSError
            The folder does not exist, or cannot be written.
        """
        if not self.settings.path.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, "is not there, or no folder", self.name)
        for path in (self.settings.taken_folder, self.settings.done_folder, self.settings.refused_folder):
            make_folder(path)
        try:
            with kernel_lock(self.settings.taken_folder / LOCK) as lock:
                self._takings.tidy()
                yield lock
        except HeldByAnother as other:
            sentence = f"the folder {self.name!r} is watched by process {other} already: stop that one"
            raise FolderWaits("watched-already", sentence) from other

    def number_refused(self) -> int:
        """Return the number of files that wait in `refused/` for a person."""
        return self._fates.number_refused()

    @property
    def left(self) -> int:
        """Number of files, complete or incomplete, that were on their way at the last inspection of the folder."""
        return len(self._on_way) + len(self.looks.whole) + len(self.looks.growing)

    @property
    def is_busy(self) -> bool:
        """True if a file can be processed further, without a trouble that holds it up."""
        taken_paths = {self._takings.path(taking) for taking in self._on_way}
        whole = {self.settings.path / name for name in self.looks.whole if len(taken_paths) < MOST_TAKEN}
        return bool({str(path) for path in taken_paths | whole} - self._news.troubles.keys())

    def go_on(self, *, look: bool) -> list[Taking]:
        """Process taken files further, and take more files; return the takings that are on their way afterwards.

        Parameters
        ----------
        look
            True to inspect the folder's files too.

        Raises
        ------
        ServiceWaits, FolderWaits, OSError, Stopped
            No file is lost: processing continues in the next round.
        """
        self._looking = look
        self._on_way = on_way = [taking for taking in self._takings.all() if not self._bring_on(taking)]
        for ended in self._backoffs.keys() - {taking.id for taking in on_way}:
            del self._backoffs[ended]
        if look:
            self.looks.look()
        for name, seen in sorted(self.looks.whole.items(), key=lambda item: (item[1][1], item[0])):
            self._stop.check()
            if len(on_way) >= MOST_TAKEN:
                break
            taking = self._take(name, seen)
            if taking is not None and not self._bring_on(taking):
                on_way.append(taking)
        return on_way

    def _take(self, name: str, seen: tuple[int, int]) -> Taking | None:
        path = self.settings.path / name
        del self.looks.whole[name]
        try:
            taking = self._takings.take(name, seen)
        except (FileChanged, FileNotFoundError):
            return None  # the next inspection sees the new state
        except OSError as error:
            if error.errno in DISK_FULL | DISK_AWAY:
                raise
            # On a Windows share the writer still has the file open.
            self._news.trouble(str(path), "not-movable", f"it cannot be taken: {error.strerror}")
            return None
        marker = self.looks.marker(name)
        if marker is not None:
            marker.unlink(missing_ok=True)
        self._news.event("taken", file=str(path), size_bytes=seen[0], taking=taking.id)
        return taking

    def _bring_on(self, taking: Taking) -> bool:
        """Process a taking further; return whether it is finished."""
        if not self._takings.is_there(taking):
            self._takings.forget(taking)
            return True
        if taking.id in self._backoffs and not self._backoffs[taking.id].is_due:
            return False
        try:
            return self._advance(taking)
        except _FileRefused as refused:
            # Read again, with the scan that was made in this round.
            self._refuse(self._takings.read_again(taking), refused.code, str(refused))
            return True
        except _FileWaits as waits:
            code, reason = waits.code, str(waits)
        except RequestFails as failure:
            self._backoffs[taking.id].put_off()
            code, reason = failure.code, str(failure)
        except FileChanged as change:
            code, reason = "file-changed", f"{change}: it is sent once it stands still"
        except OSError as error:
            if str(error.filename) != str(self._takings.path(taking)):
                raise
            code, reason = "unreadable", f"it cannot be read: {error.strerror}"
        self._news.trouble(str(self._takings.path(taking)), code, reason)
        return False

    def _advance(self, taking: Taking) -> bool:
        if taking.scan_id is None:
            taking = self._sent(taking)
        scan = self._service.found(f"/v1/scans/{taking.scan_id}", "scan-not-found")
        self._news.over(str(self._takings.path(taking)))
        if scan is None:
            raise _FileRefused("scan-not-found", f"scan {taking.scan_id} was deleted before it was read")
        if scan["state"] == "ingesting":
            return False
        if scan["state"] == "refused":
            raise _FileRefused(self._code_of(scan), scan["reason"])
        if not self._sending.is_unchanged(taking):
            reason = f"the file was written to after it was taken; scan {taking.scan_id} has what it was then"
            raise _FileRefused("file-changed", reason)
        identifiers = {"job_id": scan["job_id"], "scanner_id": scan["scanner_id"], "phantom_id": scan["phantom_id"]}
        place = self._fates.done(taking, **identifiers)
        self.counts["done"] += 1
        self._news.event("done", file=str(place), scan_id=taking.scan_id)
        return True

    def _sent(self, taking: Taking) -> Taking:
        if not taking.signature[0]:
            raise _FileRefused("empty-file", "the file is empty, though it is marked as whole")
        rule = self.settings.files_named(taking.name)
        if rule is None:
            raise _FileWaits("no-pattern", "it was taken, and no pattern of the settings matches its name any more")
        if taking.sha256 is None and taking.tries:
            self._check_still(taking)
        try:
            return self._sending.send(taking, rule.query(self.settings.scanner_id, taking.name))
        except Refusal as refusal:
            if refusal.is_of_file:
                raise _FileRefused(refusal.code, str(refusal)) from refusal
            if refusal.code in _ANOTHER_UPLOAD:
                self._service.delete_upload(str(self._takings.read_again(taking).upload_id))
            if refusal.code in {*_ANOTHER_UPLOAD, "upload-not-found", "upload-used"}:
                # The next round finds the state of the service.
                raise _FileWaits(refusal.code, str(refusal)) from refusal
            raise FolderWaits(refusal.code, str(refusal)) from refusal

    def _check_still(self, taking: Taking) -> None:
        """Check that two inspections of a file that was written to after it was taken agree."""
        present = signature(self._takings.path(taking))
        if present != taking.signature:
            self._takings.save(taking.restarted(present))
        if present != taking.signature or not self._looking:
            raise FileChanged("it was written to after it was taken")

    def _refuse(self, taking: Taking, code: str, reason: str) -> None:
        place = self._fates.refused(taking, code, reason)
        self._news.forget(str(self._takings.path(taking)))
        self.counts["refused"] += 1
        self._news.warn("refused", file=str(place), code=code, reason=reason, to_look_at=self.number_refused())

    def _code_of(self, scan: Json) -> str:
        job = self._service.get(f"/v1/jobs/{scan['job_id']}")
        return str(job["failure"]["code"]) if job["failure"] else str(job["state"])
