"""Processes as /proc shows them: found by a mark in their environment, also after a change of parent."""

import os
import signal
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

# Named so that it reaches the attempts too: of a worker's environment they have what Python and its libraries read.
MARK = "PYTHON_FAULTS_WORLD"
_PARTS = {
    "sawmill_service": "api",
    "sawmill_worker.poller": "worker",
    "sawmill_worker.celery_app": "worker",
    "sawmill_worker.attempt": "attempt",
}


def marked(world: str) -> list[int]:
    mark, every = f"{MARK}={world}".encode(), [int(path.name) for path in Path("/proc").glob("[0-9]*")]
    alive = [process_id for process_id in every if _fields(process_id)[:1] not in ([], ["Z"])]
    return [process_id for process_id in alive if mark in _read(process_id, "environ").split(b"\0")]


def playing(world: str, part: str) -> list[int]:
    """List the processes that are `api`, `worker`, `attempt`, or the `template` from which attempts are forked."""
    parts = {process_id: _part(process_id) for process_id in marked(world)}
    parents = {_parent(process_id) for process_id, played in parts.items() if played == "attempt"}
    parts |= {process_id: "template" for process_id in parents & parts.keys() if parts[process_id] == "attempt"}
    return [process_id for process_id, played in parts.items() if played == part]


def send(process_ids: Sequence[int], number: signal.Signals) -> None:
    """Send a signal to each process; one that has ended by now needs none."""
    for process_id in process_ids:
        with suppress(ProcessLookupError):
            os.kill(process_id, number)


def serving(process_ids: Sequence[int], workers: Sequence[int]) -> int:
    """Return the attempt that has a job, most likely: the oldest below a worker that has one, else any."""
    below = [
        process_id
        for process_id in process_ids
        if {_parent(process_id), _parent(_parent(process_id))}.intersection(workers)
    ]
    return min(below or process_ids, key=lambda process_id: _number(process_id, 19))


def _parent(process_id: int) -> int:
    return _number(process_id, 1)


def _number(process_id: int, place: int) -> int:
    """Read a field of /proc/PID/stat after the name: 1 is the parent's id, 19 the start time."""
    fields = _fields(process_id)
    return int(fields[place]) if fields else 0


def _fields(process_id: int) -> list[str]:
    return _read(process_id, "stat").decode(errors="replace").rpartition(")")[2].split()


def _part(process_id: int) -> str:
    words = _read(process_id, "cmdline").decode(errors="replace").split("\0")
    return next((part for name, part in _PARTS.items() if any(word.startswith(name) for word in words)), "other")


def _read(process_id: int, name: str) -> bytes:
    try:
        return Path(f"/proc/{process_id}/{name}").read_bytes()
    except (FileNotFoundError, ProcessLookupError, PermissionError):
        return b""
