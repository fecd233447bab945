"""Watching of folders until a stop is requested, or until nothing is left to do."""

import os
import time
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

from sawmill_worker.watching.backoff import LONGEST_WAIT_S, Backoff
from sawmill_worker.watching.folder import Folder, FolderWaits
from sawmill_worker.watching.news import News
from sawmill_worker.watching.sending import ShowProgress
from sawmill_worker.watching.service import Refusal, RequestFails, Service, ServiceWaits
from sawmill_worker.watching.settings import Watching
from sawmill_worker.watching.stopping import Stop, Stopped

# Time limit of a request, s, by which a waiting request can delay an orderly end.
READ_WAIT_S = 2.0
SERVICE = "service"


@dataclass
class _Held:
    """A folder, its lock while it is locked, and the time of the next try."""

    folder: Folder
    stack: ExitStack = field(default_factory=ExitStack)
    lock: TextIO | None = None
    backoff: Backoff = field(default_factory=Backoff)

    def hold(self) -> None:
        """Take the lock, again after the share was away: then the lock file of this name is another file."""
        if self.lock is not None and _is_at(self.lock):
            return
        self.release()
        self.lock = self.stack.enter_context(self.folder.locked())

    def release(self) -> None:
        self.stack.close()
        self.lock = None


def _is_at(lock: TextIO) -> bool:
    try:
        return os.path.samestat(Path(lock.name).stat(), os.fstat(lock.fileno()))
    except FileNotFoundError:
        return False


class Watcher:
    """Watcher of all folders of a settings file.

    Parameters
    ----------
    watching
        The settings.
    service, stop, show_progress
        As for `Folder`.
    """

    def __init__(self, watching: Watching, service: Service, stop: Stop, show_progress: ShowProgress) -> None:
        self._poll_s = watching.poll_s
        self._service = service
        self._stop = stop
        self._news = News()
        self._folders = [
            _Held(Folder(settings, service, self._news, stop, show_progress)) for settings in watching.folders
        ]
        self._backoff = Backoff()
        self._settles_s = max(settings.still_for_s or 0.0 for settings in watching.folders) + 2.0 * watching.poll_s

    def run(self, *, once: bool) -> bool:
        """Watch; return whether no file waits for a person at the end.

        Parameters
        ----------
        once
            End when all files that are complete, or become complete by staying constant, have reached their
            destination, or when a file must wait.

        Raises
        ------
        FolderWaits
            At the start: another process watches a folder.
        OSError
            At the start: a folder cannot be used.
        """
        with closing(self):
            for held in self._folders:
                held.hold()
                self._news.event("watching", folder=held.folder.name, refused=held.folder.number_refused())
            with suppress(Stopped):
                self._run(once=once)
            return self._summed_up()

    def close(self) -> None:
        """Release the locks, so that another process can watch."""
        for held in self._folders:
            held.release()

    def _run(self, *, once: bool) -> None:
        moved_s, ended, looks_s = time.monotonic(), 0, 0.0
        while True:
            self._stop.check()
            look = time.monotonic() >= looks_s
            if look:
                looks_s = time.monotonic() + self._poll_s
            began_s = time.monotonic()
            reading = self._round(look=look)
            moved_s += time.monotonic() - began_s  # a round's duration does not count as constant time
            now_ended = sum(held.folder.counts.total() for held in self._folders)
            if now_ended != ended:
                moved_s, ended = time.monotonic(), now_ended
            if once and self._is_over(moved_s):
                return
            self._wait(reading)

    def _round(self, *, look: bool) -> list[str]:
        """Process each folder further; return the scans that the service reads now."""
        reading: list[str] = []
        if not self._backoff.is_due:
            return reading
        for held in self._folders:
            if not held.backoff.is_due:
                continue
            folder = held.folder
            try:
                held.hold()
                reading += [str(taking.scan_id) for taking in folder.go_on(look=look) if taking.scan_id]
            except ServiceWaits as waits:
                self._backoff.put_off(waits.retry_after_s)
                self._news.trouble(SERVICE, waits.code, str(waits))
                return []
            except (FolderWaits, Refusal) as waits:  # a service of another version may also refuse
                held.backoff.put_off()
                self._news.trouble(folder.name, waits.code, str(waits))
            except OSError as error:
                held.backoff.put_off()
                self._news.trouble(folder.name, f"errno-{error.errno}", str(error))
            else:
                held.backoff.over()
                self._news.over(folder.name)
        self._backoff.over()
        self._news.over(SERVICE)
        return reading

    def _wait(self, reading: list[str]) -> None:
        """Wait until the first scan has been read, or until the next inspection is due."""
        if not reading:
            self._stop.sleep(min(self._poll_s, LONGEST_WAIT_S))
            return
        try:
            self._service.found(f"/v1/scans/{reading[0]}?wait={min(self._poll_s, READ_WAIT_S):g}", "scan-not-found")
        except ServiceWaits as waits:
            self._backoff.put_off(waits.retry_after_s)
            self._news.trouble(SERVICE, waits.code, str(waits))
        except (Refusal, RequestFails):  # the next round meets and reports the same error
            self._stop.sleep(self._poll_s)

    def _is_over(self, moved_s: float) -> bool:
        troubles = self._news.troubles
        if SERVICE in troubles:
            return True
        folders = [held.folder for held in self._folders if held.folder.name not in troubles]
        if any(folder.is_busy for folder in folders):
            return False
        return not any(folder.looks.growing for folder in folders) or time.monotonic() - moved_s > self._settles_s

    def _summed_up(self) -> bool:
        folders = [held.folder for held in self._folders]
        left = sum(folder.left for folder in folders)
        done, refused = (sum(folder.counts[fate] for folder in folders) for fate in ("done", "refused"))
        to_look_at = {folder.name: number for folder in folders if (number := folder.number_refused())}
        self._news.event("ended", done=done, refused=refused, left=left, to_look_at=to_look_at)
        return not (left or refused or self._news.troubles)
