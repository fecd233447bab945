"""Manifest and list of files of a backup, read as untrusted input."""

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
        Path in the data folder, with slashes.
    size_bytes, mtime_ns : int
        Size and time of change; the size of an unfinished upload is the number of bytes received so far.
    sha256 : str or None
        SHA-256 of the file. None: the path is an empty folder.
    """

    path: str
    size_bytes: int
    mtime_ns: int
    sha256: str | None


TableName = Annotated[str, StringConstraints(pattern=r"^[a-z_]+$")]


class Summed(Contract):
    """Size and SHA-256 of a file that is not in the data folder."""

    size_bytes: int = Field(ge=0)
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


class Table(Summed):
    """The rows of one table."""

    rows: int = Field(ge=0)


class Manifest(Contract):
    """Manifest of a backup: its source, its time and its sums.

    Attributes
    ----------
    version, revision, database
        Version of the software that made the backup, migration of the tables, and kind of the database.
    taken_at
        Instant of the rows, by the clock of the machine that made the backup.
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
        """Return sizes and sums of the files that are not below `data`, by path in the backup."""
        return {FILES: self.files, **{f"{ROWS}/{name}.jsonl": table for name, table in self.tables.items()}}


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write a manifest and its sum."""
    content = manifest.model_dump_json(indent=1).encode() + b"\n"
    for name, part in ((MANIFEST, content), (MANIFEST_SUM, f"{_sum_of(content)}  {MANIFEST}\n".encode())):
        (folder / name).write_bytes(part)


def read_manifest(folder: Path) -> Manifest:
    """Read the manifest of a backup.

    Raises
    ------
    Damaged
        There is no manifest, or the manifest is not as it was written.
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
    """Return the line of an entry."""
    return json.dumps(entry._asdict()).encode() + b"\n"


def read_entries(folder: Path) -> Iterator[Entry]:
    """Read the entries of all files of a backup.

    Raises
    ------
    Damaged
        A line is not the entry of a file that could be in a data folder together with the files before.
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
    """Open a regular file to read: no link is followed, and no pipe or device is opened.

    Raises
    ------
    Damaged
        The path is no regular file, or does not exist.
    """
    try:
        return open_regular(path)
    except FileNotFoundError as error:
        raise Damaged(f"{path} is missing") from error
    except OSError as error:
        raise Damaged(f"{path} cannot be read as a file: {error.strerror}") from error


def blocks_of(file: BinaryIO, most_bytes: int | None = None) -> Iterator[bytes]:
    """Yield the blocks of a file, up to a length.

    Raises
    ------
    Damaged
        The file cannot be read from its disk.
    """
    remaining = most_bytes
    while True:
        try:
            block = file.read(_BLOCK_BYTES if remaining is None else min(remaining, _BLOCK_BYTES))
        except OSError as error:
            raise Damaged(f"{file.name} cannot be read: {error.strerror}") from error
        if not block:
            return
        remaining = None if remaining is None else remaining - len(block)
        yield block


def summed(path: Path, counted: Counted = lambda _: None) -> Summed:
    """Compute size and SHA-256 of a file.

    Raises
    ------
    Damaged
        The path is no file, or the file cannot be read.
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


def folders() -> set[str]:
    """Return the folders in the data folder from which a backup may have files."""
    return {"uploads", UNFINISHED, EXAMPLES, *(kind.plural for kind in JobKind.all())}


def _is_of_data_folder(path: object) -> bool:
    if not isinstance(path, str):
        return False
    first, *rest = path.split("/")
    return first in folders() and bool(rest) and all(_NAME.fullmatch(part) and part not in {".", ".."} for part in rest)
