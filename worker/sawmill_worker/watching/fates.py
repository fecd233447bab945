"""Where a file ends: in `done/` or `refused/`, by its day, with what became of it beside it.

The sidecar is written first and holds the taking's id: whoever comes back after a kill knows by it which place was
chosen. No file and no sidecar that is there already is written over.
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
    """For one folder."""

    def __init__(self, settings: WatchedFolder, takings: Takings) -> None:
        self._settings = settings
        self._takings = takings
        # Where the next file of a name may find its place: a scanner may give all of a day the same one.
        self._first_free: dict[Path, int] = {}

    def done(self, taking: Taking, **known: object) -> Path:
        """The service has read it; its place, and beside it `NAME.json`."""
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
        """Somebody must look at it; its place, and beside it `NAME.reason.txt`."""
        scan = [] if taking.scan_id is None else [f"scan: {taking.scan_id}"]
        lines = [reason, f"code: {code}", *scan, f"taken_at: {taking.taken_at}", f"taking: {taking.id}", ""]
        return self._end(taking, self._settings.refused_folder, REFUSED, "\n".join(lines))

    def number_refused(self) -> int:
        """How many wait for somebody."""
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
    """`scan.h5`, `scan-2.h5` and so on, from a number on, each with its sidecar."""
    while True:
        target = path if number == 1 else path.with_name(f"{path.stem}-{number}{path.suffix}")
        yield number, target, target.with_name(target.name + suffix)
        number += 1


def _is_of(sidecar: Path, taking: Taking) -> bool:
    try:
        return taking.id in sidecar.read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        return False
