"""Work of `sawmill watch`."""

from pathlib import Path

from sawmill_worker.watching.checking import CheckResult, findings
from sawmill_worker.watching.folder import FolderWaits
from sawmill_worker.watching.sending import ShowProgress
from sawmill_worker.watching.service import Service
from sawmill_worker.watching.settings import read_settings
from sawmill_worker.watching.stopping import Stop
from sawmill_worker.watching.watcher import Watcher


class CannotWatch(Exception):  # noqa: N818 - as the sentence says
    """A folder cannot be watched from the start; the sentence gives the reason."""


def check(file: Path) -> list[CheckResult]:
    """Describe what would be done, in sentences, each with whether all is well.

    Raises
    ------
    WrongFileError
        The file describes no watched folders.
    CannotWatch
        The certificates cannot be read.
    """
    watching = read_settings(file)
    try:
        with Service(watching, Stop()) as service:
            return list(findings(watching, service))
    except OSError as error:
        raise CannotWatch(str(error)) from error


def watch(file: Path, show_progress: ShowProgress, *, once: bool) -> bool:
    """Watch until a signal comes, or once; return whether no file waits for a person at the end.

    Raises
    ------
    WrongFileError
        The file describes no watched folders.
    CannotWatch
        A folder does not exist, cannot be written, or is watched by another process.
    """
    watching, stop = read_settings(file), Stop()
    try:
        with stop.on_signals(), Service(watching, stop) as service:
            return Watcher(watching, service, stop, show_progress).run(once=once)
    except (FolderWaits, OSError) as error:
        raise CannotWatch(str(error)) from error
