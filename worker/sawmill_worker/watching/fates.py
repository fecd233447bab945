"""Destination of a file: `done/` or `refused/`, by day, with a sidecar file about the outcome.

The sidecar is written first and holds the taking's id, so that a process after a kill finds the path that was chosen.
No existing file or sidecar is overwritten.
"""

import json
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sawmill_worker.watching.durable import make_folder, move, write_durably
from sawmill_worker.watching.settings import WatchedFolder
from sawmill_worker.watching.takings import Taking, Takings

DONE, REFUSED = ".json", ".reason.txt"


class Fates:
    """Destinations of the files of one folder."""

    def __init__(self, settings: WatchedFolder, takings: Takings) -> None:
        self._settings = settings
        self._takings = takings
        # Next free number by name: a scanner may give all files of a day the same name.
        self._first_free: dict[Path, int] = {}

    def done(self, taking: Taking, **known: object) -> Path:
        """Move a file that the service has read to `done/`, with a sidecar `NAME.json`; return its path."""
        document: dict[str, Any] = {
            "file": taking.name,
            "scan_id": taking.scan_id,
            **known,
            "sha256": taking.sha256,
            "size_bytes": taking.signature[0],
            "taken_at": taking.taken_at,
            "done_at": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "taking": taking.id,
        }
        return self._end(taking, self._settings.done_folder, DONE, json.dumps(document, indent=1) + "\n")

    def refused(self, taking: Taking, code: str, reason: str) -> Path:
        """Move a file that a person must check to `refused/`, with a sidecar `NAME.reason.txt`; return its path."""
        scan = [] if taking.scan_id is None else [f"scan: {taking.scan_id}"]
        lines = [reason, f"code: {code}", *scan, f"taken_at: {taking.taken_at}", f"taking: {taking.id}", ""]
        return self._end(taking, self._settings.refused_folder, REFUSED, "\n".join(lines))

    def number_refused(self) -> int:
        """Return the number of files that wait for a person."""
        return sum(1 for _ in self._settings.refused_folder.glob(f"*/*{REFUSED}"))

    def _end(self, taking: Taking, folder: Path, suffix: str, text: str) -> Path:
        make_folder(folder / taking.day)
        path = folder / taking.day / taking.name
        number, target, sidecar = next(
            (number, target, sidecar)
            for number, target, sidecar in _places(path, suffix, self._first_free.get(path, 1))
            if not (target.exists() or sidecar.exists()) or _is_of(sidecar, taking)
        )
        write_durably(sidecar, text)
        move(self._takings.path(taking), target)
        self._takings.forget(taking)
        if number > 1:
            self._first_free = {other: free for other, free in self._first_free.items() if other.parent == path.parent}
            self._first_free[path] = number + 1
        return target


def _places(path: Path, suffix: str, number: int) -> Iterator[tuple[int, Path, Path]]:
    """Yield `scan.h5`, `scan-2.h5` and so on from a number on, each with its sidecar."""
    while True:
        target = path if number == 1 else path.with_name(f"{path.stem}-{number}{path.suffix}")
        yield number, target, target.with_name(target.name + suffix)
        number += 1


def _is_of(sidecar: Path, taking: Taking) -> bool:
    try:
        return taking.id in sidecar.read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        return False
