"""Checkpoints of an attempt: written next to the results, kept with the job, read by the next attempt.

A file is a seal (a mark, the checksum and the length of the rest) and an NPZ archive: the arrays, and as `origin` the
JSON of their input. A file that a kill or a power loss left incomplete does not match its seal.
"""

import json
import struct
import threading
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import structlog
from numpy.typing import NDArray

from sawmill_calibration.checkpoints import Arrays, Keeper, MadeWith
from sawmill_platform.errors import FolderUnavailable, StorageFull, disk_outage_reported
from sawmill_platform.files.file_store import check_room
from sawmill_platform.files.whole_files import whole_file
from sawmill_worker.jobs.attempt import MillAttempt
from sawmill_worker.software import software

_SEAL = struct.Struct("<8sIQ")
_MARK = b"SAWKEPT1"
_ORIGIN = "origin"
_READ_BYTES = 2**20


class UnusableCheckpoint(Exception):  # noqa: N818 - an outcome's name, as in `files.errors`
    """A checkpoint that is damaged, or of another computation; the sentence tells which."""


def write_checkpoint(path: Path, origin: Mapping[str, Any], arrays: Arrays) -> None:
    """Write arrays and the JSON-able values that they depend on, whole or not at all; no array's name is `origin`."""
    with whole_file(path) as file:
        file.write(bytes(_SEAL.size))
        np.savez(file, allow_pickle=False, **{_ORIGIN: _packed(origin)}, **arrays)
        length = file.tell() - _SEAL.size
        checksum = _checksum(file)
        file.seek(0)
        file.write(_SEAL.pack(_MARK, checksum, length))


def read_checkpoint(path: Path, origin: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """Read the arrays of a checkpoint, or raise `UnusableCheckpoint` for a damaged file and for another origin."""
    with path.open("rb") as file:
        head = file.read(_SEAL.size)
        if len(head) < _SEAL.size or head != _SEAL.pack(_MARK, _checksum(file), path.stat().st_size - _SEAL.size):
            raise UnusableCheckpoint("it is damaged")
        file.seek(_SEAL.size)
        with np.load(file, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
    made_from = json.loads(arrays.pop(_ORIGIN).tobytes())
    expected = json.loads(_packed(origin).tobytes())
    if made_from != expected:
        names = (made_from.keys() | expected.keys()) - {
            name for name in made_from if made_from[name] == expected.get(name)
        }
        raise UnusableCheckpoint(f"it was computed from another {', '.join(sorted(names))}")
    return arrays


def _packed(origin: Mapping[str, Any]) -> NDArray[np.uint8]:
    return np.frombuffer(json.dumps(origin).encode(), np.uint8)


def _checksum(file: BinaryIO) -> int:
    """Compute the checksum of all that follows the seal."""
    file.seek(_SEAL.size)
    checksum = 0
    while part := file.read(_READ_BYTES):
        checksum = zlib.crc32(part, checksum)
    return checksum


# Seconds of work between checkpoints: a short job writes none, and a long job spends little of its time on them. A
# second or later attempt writes one at once and doubles the pauses, so that it makes progress however soon it ends.
PAUSE_S, SECOND_PAUSE_AGAIN_S = 5.0, 0.5
# Number of names in one announcement, which must fit into one line of a pipe.
MOST_ANNOUNCED = 100


class AttemptKeeper(Keeper):
    """A keeper for one attempt, whose progress depends on the `origin` (JSON) and the software.

    A checkpoint that does not fit on the disk, with the bytes that the results need, is left out: a job can finish
    without. The next is due after the usual pause, and the log has one line until a checkpoint fits again.
    """

    def __init__(self, attempt: MillAttempt, origin: Mapping[str, Any], *, still_to_write_bytes: int = 0) -> None:
        self._attempt = attempt
        self._origin = {**origin, "software": software()}
        self._still_to_write_bytes = still_to_write_bytes
        self._pause_began_at = self._attempt.monotonic()
        self._pause_s = PAUSE_S if attempt.job.attempt <= 1 else 0.0
        self._unannounced: list[str] = []
        self._begun, self._taken_up, self._left_out, self._lock = False, False, False, threading.Lock()
        # The log fields are bound here because `keep` may be called in a thread without the attempt's log fields.
        job = attempt.job
        self._log = structlog.get_logger().bind(job_id=job.id, attempt=job.attempt, kind=job.kind)

    @property
    def has_begun(self) -> bool:
        """True if the attempt has worked for its first pause."""
        return self._begun or self.is_due

    @property
    def is_due(self) -> bool:
        """True if the pause is over."""
        return self._attempt.monotonic() - self._pause_began_at >= self._pause_s

    def keep(self, name: str, arrays: Arrays, made_with: MadeWith | None = None) -> None:
        """Write a checkpoint, which is announced together with other checkpoints when the pause is over."""
        needed = self._still_to_write_bytes + sum(array.nbytes for array in arrays.values())
        folder = self._attempt.checkpoints
        try:
            check_room(self._attempt.output, needed, needed_by="a checkpoint beside the result")
            with disk_outage_reported("a checkpoint"):
                folder.mkdir(exist_ok=True)
                write_checkpoint(folder / name, {**self._origin, "made_with": made_with}, arrays)
        except (StorageFull, FolderUnavailable) as error:
            with self._lock:
                if not self._left_out:
                    self._log.warning("checkpoint-left-out", name=name, reason=str(error))
                self._left_out = True
                if self.is_due:
                    self._announce()
            return
        with self._lock:
            self._left_out = False
            self._unannounced.append(name)
            if self.is_due or len(self._unannounced) == MOST_ANNOUNCED:
                self._announce()

    def _announce(self) -> None:
        names, self._unannounced = self._unannounced, []
        if names:
            self._attempt.announce(names)
        self._begun, self._pause_began_at = True, self._attempt.monotonic()
        self._pause_s = min(max(2.0 * self._pause_s, SECOND_PAUSE_AGAIN_S), PAUSE_S)

    def kept(self, name: str, made_with: MadeWith | None = None) -> Arrays | None:
        """Return what an earlier attempt wrote; an unusable checkpoint is skipped, with a line in the log."""
        path = self._attempt.given.kept / name
        try:
            arrays = read_checkpoint(path, {**self._origin, "made_with": made_with})
        except FileNotFoundError:
            return None
        except (UnusableCheckpoint, OSError) as error:
            self._log.warning("checkpoint-passed-over", name=name, reason=str(error))
            return None
        if not self._taken_up:
            self._log.info("checkpoint-taken-up", name=name)
        self._taken_up = True
        return arrays
