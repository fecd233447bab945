"""Records on disk of the files taken out of a folder, so that a killed process finds the files again.

A taking is `taken/ID.json` and `taken/ID/NAME`. The record is written first, then the file is moved there by one
rename, so that its writer may use the name again. Later values are added to the record before they are used:

    sha256      checksum of the data that are sent
    upload_id   the service's id of the upload; an upload gives one scan, however often the scan is requested
    scan_id     the scan that was made from the upload

The record is deleted last, when the file is in `done/` or `refused/`.
"""

import errno
import json
import os
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self
from uuid import uuid4

from sawmill_platform.files.whole_files import flush_names, open_regular
from sawmill_worker.watching.durable import (
    FileChanged,
    Signature,
    make_folder,
    move,
    signature_of,
    write_durably,
)

_RECORD = ".json"
_IDENTIFIER = r"[a-z0-9][a-z0-9-]{0,63}"
_TIME = r"\d{4}-\d\d-\d\dT[\d:.+Z-]+"
_MAY_BE_NULL = {"sha256": r"[0-9a-f]{64}", "upload_id": _IDENTIFIER, "upload_began": _TIME, "scan_id": _IDENTIFIER}
_SHAPES = {"id": r"[0-9a-f]{32}", "name": r"[^/\0]+", "taken_at": _TIME, **_MAY_BE_NULL}


@dataclass(frozen=True)
class Taking:
    """A taken file on its way.

    Attributes
    ----------
    id : str
        Identifier of this taking; another file of the same name gets another identifier.
    name : str
        Name of the file.
    signature : tuple of int
        Size in bytes and time of the last change in ns of the file when it was taken.
    taken_at : str
        Time in RFC 3339, UTC, by this machine's clock; no decision depends on the time.
    tries : int
        Number of uploads of the file that were given up before the present one.
    sha256, upload_id, scan_id : str or None
        None if not known yet.
    upload_began : str or None
        Time at which the upload was declared, by the service's clock.
    """

    id: str
    name: str
    signature: Signature
    taken_at: str
    tries: int = 0
    sha256: str | None = None
    upload_id: str | None = None
    upload_began: str | None = None
    scan_id: str | None = None

    @property
    def day(self) -> str:
        """Day of `taken_at`, which is the folder's name in `done/` and `refused/`."""
        return self.taken_at[:10]

    @property
    def upload_name(self) -> str:
        """Key by which the service recognises a repeated request for the upload of one try."""
        return f"watch-{self.id}-{self.tries}"

    def restarted(self, signature: Signature) -> Self:
        """Return the taking of the changed file, with nothing sent yet."""
        return replace(
            self,
            signature=signature,
            tries=self.tries + 1,
            sha256=None,
            upload_id=None,
            upload_began=None,
            scan_id=None,
        )

    @classmethod
    def read(cls, text: str) -> Self:
        """Parse a record; refuse values that would lead elsewhere as a path or in an address."""
        fields: dict[str, Any] = json.loads(text)
        size, changed = (int(number) for number in fields["signature"])
        taking = cls(**fields | {"signature": (size, changed), "tries": int(fields.get("tries", 0))})
        for name, shape in _SHAPES.items():
            value = getattr(taking, name)
            if not (re.fullmatch(shape, value) if value is not None else name in _MAY_BE_NULL):
                raise ValueError(name)
        return taking


class Takings:
    """Takings of one folder, from which only this process takes files.

    Parameters
    ----------
    folder
        The watched folder.
    taken
        `taken/` in the watched folder.
    """

    def __init__(self, folder: Path, taken: Path) -> None:
        self._folder = folder
        self._taken = taken

    def all(self) -> list[Taking]:
        """Return all takings, the oldest first."""
        return sorted(self._read(), key=lambda taking: (taking.taken_at, taking.name, taking.id))

    def path(self, taking: Taking) -> Path:
        """Return the path of the taken file."""
        return self._taken / taking.id / taking.name

    def take(self, name: str, inspected: Signature) -> Taking:
        """Take a file, which must be unchanged since its inspection.

        Raises
        ------
        FileChanged
            The file has changed.
        OSError
            The file cannot be read or moved, for example because its writer holds it open on a share; it is not moved.
        """
        with open_regular(self._folder / name) as file:
            if signature_of(file) != inspected:
                raise FileChanged("it changed when it was to be taken")
        taking = Taking(uuid4().hex, name, inspected, datetime.now(UTC).isoformat(timespec="milliseconds"))
        self.save(taking)
        try:
            make_folder(self.path(taking).parent)
            move(self._folder / name, self.path(taking))
        except OSError:
            self.forget(taking)
            raise
        return taking

    def save(self, taking: Taking) -> Taking:
        """Write the record of a taking."""
        write_durably(self._record(taking), json.dumps(asdict(taking)))
        return taking

    def read_again(self, taking: Taking) -> Taking:
        """Return the taking as its record is now."""
        return Taking.read(self._record(taking).read_text(encoding="utf-8"))

    def is_there(self, taking: Taking) -> bool:
        """Return whether the file exists; it does not if a process was killed before the move, or at the end."""
        return os.path.lexists(self.path(taking))

    def forget(self, taking: Taking) -> None:
        """Remove a record whose file is elsewhere."""
        with suppress(FileNotFoundError):
            self.path(taking).parent.rmdir()
        self._record(taking).unlink(missing_ok=True)
        flush_names(self._taken)

    def tidy(self) -> None:
        """Remove files that a killed process left unfinished."""
        for part in self._taken.glob(f".*{_RECORD}.part"):
            part.unlink()

    def _record(self, taking: Taking) -> Path:
        return self._taken / f"{taking.id}{_RECORD}"

    def _read(self) -> Iterator[Taking]:
        for path in self._taken.glob(f"*{_RECORD}"):
            try:
                with open_regular(path) as file:
                    taking = Taking.read(file.read().decode())
            except (ValueError, TypeError, KeyError) as error:
                raise _no_record(path) from error
            # A user who can write into the folder could write a record that leads elsewhere.
            if taking.id != path.stem or self.path(taking).parent.is_symlink():
                raise _no_record(path)
            yield taking


def _no_record(path: Path) -> OSError:
    return OSError(errno.EINVAL, "is no record of a file that was taken", str(path))
