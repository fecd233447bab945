"""What has been taken out of a folder, on its disk: whoever is killed finds it again.

A taking is `taken/ID.json` and `taken/ID/NAME`. The record is written first, then the file is moved there by one
rename, so that its writer may use the name again. What follows is added to the record before it is needed:

    sha256      what is sent
    upload_id   the service's name for it; of one upload there is one scan, whoever asks how often
    scan_id     what was made of it

The record goes last, when the file is in `done/` or `refused/`.
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
    """A file on its way.

    Attributes
    ----------
    id : str
        Of this taking; another file of the same name gets another one.
    name : str
        The file's.
    signature : tuple of int
        Its size in bytes and the time of its last change in ns, as it was taken.
    taken_at : str
        RFC 3339, UTC; of this machine's clock, which decides nothing.
    tries : int
        How many uploads of it were given up before this one.
    sha256, upload_id, scan_id : str or None
        None: not known yet.
    upload_began : str or None
        When the upload was made, by the service's clock.
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
        """Of `taken_at`: the folder's name in `done/` and `refused/`."""
        return self.taken_at[:10]

    @property
    def upload_name(self) -> str:
        """By which the service knows that one try's upload is asked for again."""
        return f"watch-{self.id}-{self.tries}"

    def anew(self, signature: Signature) -> Self:
        """The same with nothing sent yet."""
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
        """From a record, with nothing in it that leads elsewhere as a path or in an address."""
        fields: dict[str, Any] = json.loads(text)
        size, changed = (int(number) for number in fields["signature"])
        taking = cls(**fields | {"signature": (size, changed), "tries": int(fields.get("tries", 0))})
        for name, shape in _SHAPES.items():
            value = getattr(taking, name)
            if not (re.fullmatch(shape, value) if value is not None else name in _MAY_BE_NULL):
                raise ValueError(name)
        return taking


class Takings:
    """Those of one folder, which this process alone takes from.

    Parameters
    ----------
    folder
        The watched one.
    taken
        `taken/` in it.
    """

    def __init__(self, folder: Path, taken: Path) -> None:
        self._folder = folder
        self._taken = taken

    def all(self) -> list[Taking]:
        """The oldest first."""
        return sorted(self._read(), key=lambda taking: (taking.taken_at, taking.name, taking.id))

    def path(self, taking: Taking) -> Path:
        """Of the file."""
        return self._taken / taking.id / taking.name

    def take(self, name: str, looked: Signature) -> Taking:
        """Take a file as it was looked at.

        Raises
        ------
        FileChanged
            It is another one by now.
        OSError
            It cannot be read or moved, as where its writer holds it open on a share; it is where it was.
        """
        with open_regular(self._folder / name) as file:
            if signature_of(file) != looked:
                raise FileChanged("it changed when it was to be taken")
        taking = Taking(uuid4().hex, name, looked, datetime.now(UTC).isoformat(timespec="milliseconds"))
        self.save(taking)
        try:
            make_folder(self.path(taking).parent)
            move(self._folder / name, self.path(taking))
        except OSError:
            self.forget(taking)
            raise
        return taking

    def save(self, taking: Taking) -> Taking:
        """Write the record."""
        write_durably(self._record(taking), json.dumps(asdict(taking)))
        return taking

    def read_again(self, taking: Taking) -> Taking:
        """As its record has it by now."""
        return Taking.read(self._record(taking).read_text(encoding="utf-8"))

    def is_there(self, taking: Taking) -> bool:
        """Whether the file is; it is not where a process was killed between the record and the move, or at the end."""
        return os.path.lexists(self.path(taking))

    def forget(self, taking: Taking) -> None:
        """Remove a record whose file is elsewhere."""
        with suppress(FileNotFoundError):
            self.path(taking).parent.rmdir()
        self._record(taking).unlink(missing_ok=True)
        flush_names(self._taken)

    def tidy(self) -> None:
        """Remove what a killed process had begun to write."""
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
            # Whoever writes into the folder could write one that leads elsewhere.
            if taking.id != path.stem or self.path(taking).parent.is_symlink():
                raise _no_record(path)
            yield taking


def _no_record(path: Path) -> OSError:
    return OSError(errno.EINVAL, "is no record of a file that was taken", str(path))
