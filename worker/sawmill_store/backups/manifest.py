"""What a backup says of itself, and how it is read: by somebody who does not trust it."""

import hashlib
import json
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, BinaryIO, Literal, NamedTuple

from pydantic import Field, StringConstraints, ValidationError

from sawmill_platform.contracts.base import Contract, Time
from sawmill_platform.contracts.jobs import JobKind
from sawmill_platform.errors import Damaged
from sawmill_platform.files.file_store import EXAMPLES, UNFINISHED
from sawmill_platform.files.whole_files import open_regular

MANIFEST, MANIFEST_SUM, FILES, ROWS, DATA = "manifest.json", "manifest.sha256", "files.jsonl", "rows", "data"
FORMAT = 1
# Folders of the data folder of which a backup may have files.
FOLDERS = frozenset({"uploads", UNFINISHED, EXAMPLES, *(kind.plural for kind in JobKind.all())})

Counted = Callable[[int], None]

_SUM = re.compile(r"[0-9a-f]{64}")
_NAME = re.compile(r"[^/\\\x00-\x1f]+")
_LONGEST_LINE = 2**14
_BLOCK_BYTES = 4 * 2**20


class Entry(NamedTuple):
    """A file of a backup.

    Attributes
    ----------
    path : str
        In the data folder, with slashes.
    size_bytes, mtime_ns : int
        Of an upload that still comes, the size is what has come.
    sha256 : str or None
        None: it is an empty folder.
    """

    path: str
    size_bytes: int
    mtime_ns: int
    sha256: str | None


TableName = Annotated[str, StringConstraints(pattern=r"^[a-z_]+$")]


class Summed(Contract):
    """A file that is no part of the data folder."""

    size_bytes: int = Field(ge=0)
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


class Table(Summed):
    """The rows of one table."""

    rows: int = Field(ge=0)


class Manifest(Contract):
    """What a backup is of.

    Attributes
    ----------
    version, revision, database
        The software that made it, the migration that its tables were at, and the kind of database.
    taken_at
        The instant at which the rows were as they are here, by the clock of the machine that made it.
    lacking
        Paths of files that rows name and that could not be read.
    """

    format: Literal[1] = 1
    version: str
    revision: str = Field(pattern=r"^[0-9]{4}$")
    database: Literal["sqlite", "postgresql"]
    taken_at: Time
    tables: dict[TableName, Table]
    files: Summed
    number_of_files: int = Field(ge=0)
    bytes_of_files: int = Field(ge=0)
    lacking: list[str]

    def parts(self) -> Mapping[str, Summed]:
        """By path in the backup: what is not below `data`."""
        return {FILES: self.files, **{f"{ROWS}/{name}.jsonl": table for name, table in self.tables.items()}}


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write it and its sum."""
    content = manifest.model_dump_json(indent=1).encode() + b"\n"
    for name, part in ((MANIFEST, content), (MANIFEST_SUM, f"{_sum_of(content)}  {MANIFEST}\n".encode())):
        (folder / name).write_bytes(part)


def read_manifest(folder: Path) -> Manifest:
    """The manifest of a backup.

    Raises
    ------
    Damaged
        There is none, or it is not as it was written.
    """
    if not (folder / MANIFEST).exists():
        raise Damaged(f"{str(folder)!r} is no backup of this product: it has no {MANIFEST}")
    with open_plain(folder / MANIFEST) as file, open_plain(folder / MANIFEST_SUM) as sums:
        content, expected = file.read(), sums.read(200).decode("ascii", "replace").partition(" ")[0]
    if _sum_of(content) != expected:
        raise Damaged(f"{MANIFEST} is damaged: its SHA-256 is {_sum_of(content)}, and {MANIFEST_SUM} has {expected!r}")
    try:
        if (made := json.loads(content).get("format")) != FORMAT:
            raise Damaged(f"the backup has the format {made!r}, and this version of the software reads {FORMAT} alone")
        return Manifest.model_validate_json(content)
    except (ValueError, AttributeError, RecursionError, ValidationError) as error:
        raise Damaged(f"{MANIFEST} is none of a backup: {' '.join(str(error).split())}") from error


def write_entry(entry: Entry) -> bytes:
    """Its line."""
    return json.dumps(entry._asdict()).encode() + b"\n"


def read_entries(folder: Path) -> Iterator[Entry]:
    """All files of a backup.

    Raises
    ------
    Damaged
        A line is none of a file that could be in a data folder beside those before it.
    """
    with open_plain(folder / FILES) as file:
        number, files, folders = 0, set[str](), set[str]()
        while line := file.readline(_LONGEST_LINE):
            number += 1
            entry = _entry(line)
            if entry is None:
                sentence = line[:200].decode(errors="replace").strip()
                raise Damaged(f"line {number} of {FILES} names no file of a data folder: {sentence}")
            above = {entry.path[: slash.start()] for slash in re.finditer("/", entry.path)}
            if entry.path in files or entry.path in folders or above & files:
                raise Damaged(f"line {number} of {FILES} names {entry.path}, where another line has a file")
            files.add(entry.path)
            folders |= above
            yield entry


def open_plain(path: Path) -> BinaryIO:
    """A file to read, where it is a file: no link is followed, and no pipe or device opened.

    Raises
    ------
    Damaged
        It is something else, or is not there.
    """
    try:
        return open_regular(path)
    except FileNotFoundError as error:
        raise Damaged(f"{path} is missing") from error
    except OSError as error:
        raise Damaged(f"{path} cannot be read as a file: {error.strerror}") from error


def blocks_of(file: BinaryIO, most_bytes: int | None = None) -> Iterator[bytes]:
    """What a file holds, up to a length.

    Raises
    ------
    Damaged
        Its disk does not give it.
    """
    left = most_bytes
    while True:
        try:
            block = file.read(_BLOCK_BYTES if left is None else min(left, _BLOCK_BYTES))
        except OSError as error:
            raise Damaged(f"{file.name} cannot be read: {error.strerror}") from error
        if not block:
            return
        left = None if left is None else left - len(block)
        yield block


def summed(path: Path, counted: Counted = lambda _: None) -> Summed:
    """Size and SHA-256 of a file as it is.

    Raises
    ------
    Damaged
        It is no file, or cannot be read.
    """
    computed, size_bytes = hashlib.sha256(), 0
    with open_plain(path) as file:
        for block in blocks_of(file):
            computed.update(block)
            size_bytes += len(block)
            counted(len(block))
    return Summed(size_bytes=size_bytes, sha256=computed.hexdigest())


def _sum_of(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _entry(line: bytes) -> Entry | None:
    try:
        read: Any = json.loads(line)
        entry = Entry(**read)
    except (ValueError, TypeError, RecursionError):
        return None
    numbers = (entry.size_bytes, entry.mtime_ns)
    right = (
        _is_of_data_folder(entry.path)
        and all(type(number) is int and 0 <= number < 2**63 for number in numbers)
        and (entry.sha256 is None or (isinstance(entry.sha256, str) and _SUM.fullmatch(entry.sha256) is not None))
    )
    return entry if right else None


def _is_of_data_folder(path: object) -> bool:
    if not isinstance(path, str):
        return False
    first, *rest = path.split("/")
    return first in FOLDERS and bool(rest) and all(_NAME.fullmatch(part) and part not in {".", ".."} for part in rest)
