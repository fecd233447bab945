"""Watchers as processes of their own, which a test may kill: each is forked from a process that has imported all."""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from sawmill_platform.workers.logs import configure_logs
from sawmill_vocabulary import ProgressCallback
from sawmill_worker.watching.command import watch


@contextlib.contextmanager
def no_progress(_what: str) -> Iterator[ProgressCallback]:
    yield lambda _progress: None


@contextlib.contextmanager
def watchers(settings: Path, log: Path) -> Iterator[Callable[[], int]]:
    """Start one whenever asked, with its log in a file; its process id. All end with the block."""
    command = [sys.executable, __file__, str(settings), str(log)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True) as origin:

        def start() -> int:
            origin.stdin.write(b"\n")
            origin.stdin.flush()
            return int(origin.stdout.readline())

        try:
            yield start
        finally:
            os.killpg(origin.pid, signal.SIGKILL)


def kill(process_id: int) -> None:
    """As a power cut would."""
    os.kill(process_id, signal.SIGKILL)


def _fork_on_request(settings: Path, log: Path) -> None:
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # none is waited for
    while sys.stdin.buffer.read(1):
        process_id = os.fork()
        if not process_id:
            with log.open("a", buffering=1) as sys.stderr:
                configure_logs("json")
                watch(settings, no_progress, once=False)
            os._exit(0)
        sys.stdout.write(f"{process_id}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    _fork_on_request(Path(sys.argv[1]), Path(sys.argv[2]))
