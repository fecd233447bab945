"""Refusals of files, and the one place where a library's error becomes a sentence.

FileError
  UnreadableScan  a file that cannot be used
  OutOfRange      an index that a file of ours does not have
  NotStored       a part that a file of ours does not hold
"""

import errno
import re
import stat
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sawmill_platform.errors import DamagedResult
from sawmill_platform.files.whole_files import DISK_AWAY, DISK_FULL

LONGEST_QUOTE = 200
# Characters kept at the beginning and at the end of a sentence that lists what a file holds; the end says what to do.
LONGEST_SENTENCE, SENTENCE_END = 1000, 250
# Errors of a parser that trusted the file: their texts are about the parser.
OF_THE_PROGRAM = (ArithmeticError, AssertionError, AttributeError, LookupError, NameError, TypeError, struct.error)
OF_NO_USE = ("pickle", " object at 0x")  # no advice to trust a file, no addresses
# What HDF5 reports of a file that its writer still holds, and of one whose writer ended before it closed the file.
LOCKED, NOT_CLOSED = "unable to lock file", "h5clear"
FULL_PATH = re.compile(r"(?<![\w.])(?:/[^\s/'\":;,()]+){2,}")

# Faults of the machine, not of the file: another attempt may succeed.
MACHINE_ERRORS = (
    DISK_FULL | DISK_AWAY | {errno.EACCES, errno.EFBIG, errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EPERM}
)


class FileError(Exception):
    """A file's fault, in a sentence of bounded length; `code` is stable, for programs."""

    def __init__(self, code: str, message: str) -> None:
        if len(message) > LONGEST_SENTENCE:
            message = f"{message[: LONGEST_SENTENCE - SENTENCE_END]} ... {message[-SENTENCE_END:]}"
        super().__init__(message)
        self.code = code


class UnreadableScan(FileError):  # noqa: N818 - it names the thing that cannot be read
    """A file, or a parameter given with it, that cannot be used as a scan.

    `code`, for programs, is stable: `empty-file`, `file-in-use`, `picture-file`, `picture-not-png`, `unknown-format`,
    `broken-file`, `truncated-file`, `too-large`, `external-storage`, `linked-file-missing`, `unsupported-storage`,
    `dataset-missing`, `dataset-ambiguous`, `wrong-type`, `wrong-shape`, `angles-missing`, `angles-mismatch`, `angles-
    malformed`, `angles-repeated`, `not-finite`, `out-of-range`, `no-signal`, `rows-missing`, `flats-missing`,
    `contradiction`, `unsafe-archive`.
    """


class OutOfRange(FileError):  # noqa: N818 - an outcome's name, as in `storage.errors`
    """An index that a file of ours does not have."""


class NotStored(FileError):  # noqa: N818
    """A part that a file of ours may hold and this file does not."""


class NotAsWritten(ValueError):  # noqa: N818
    """A fault in a file of ours; `damage_reported` makes a sentence of it."""


def check_index(name: str, index: int, length: int) -> None:
    """Refuse an index outside 0 .. length - 1."""
    if not 0 <= index < length:
        raise OutOfRange(f"{name}-out-of-range", f"{name} must be between 0 and {length - 1}, not {index}")


@contextmanager
def library_errors_translated(what: str) -> Iterator[None]:
    """Turn whatever a parsing library raises on a damaged file into `UnreadableScan`, the cause chained.

    The libraries document no closed list of exceptions for hostile input, so all exceptions are caught, apart from
    those that tell of the machine (memory, disk) and nothing about the file.
    """
    try:
        yield
    except (UnreadableScan, MemoryError):
        raise
    except Exception as error:
        if isinstance(error, OSError) and error.errno in MACHINE_ERRORS:
            raise
        if LOCKED in str(error):
            raise UnreadableScan(
                "file-in-use", f"another program has this {what} file open for writing; try again when it is closed"
            ) from error
        if NOT_CLOSED in str(error):
            raise UnreadableScan(
                "broken-file",
                f"the program that writes this {what} file has not closed it; wait until it has finished, or export "
                "the file again if that program ended early (h5clear -s marks the file as closed)",
            ) from error
        reason = _reason(error)
        code = "truncated-file" if "truncated file" in reason else "broken-file"
        raise UnreadableScan(code, f"this {what} file is incomplete or damaged ({reason}); export it again") from error


@contextmanager
def damage_reported(name: str) -> Iterator[None]:
    """Turn whatever is raised on a damaged file of ours into `DamagedResult`, the cause chained."""
    try:
        yield
    except (NotAsWritten, UnreadableScan) as error:
        raise DamagedResult(name, str(error)) from error
    except (DamagedResult, FileError, MemoryError):
        raise
    except Exception as error:
        if isinstance(error, OSError) and error.errno in MACHINE_ERRORS:
            raise
        raise DamagedResult(name, _reason(error)) from error


def _reason(error: Exception) -> str:
    """Return a library's message where it is about the file: not about the library, paths or trust in pickles."""
    text = str(error)
    if not text or isinstance(error, OF_THE_PROGRAM) or any(words in text for words in OF_NO_USE):
        return "its structure makes no sense"
    return quoted(FULL_PATH.sub("...", text))


def quoted(text: str) -> str:
    """Shorten foreign text to one printable line, fit for use inside a sentence."""
    line = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    return line if len(line) <= LONGEST_QUOTE else line[: LONGEST_QUOTE - 3] + "..."


def check_regular(path: Path) -> None:
    """Refuse what is no file on a disk: reading a pipe would wait without end, and a device has no end."""
    if not stat.S_ISREG(path.stat().st_mode):
        raise UnreadableScan("broken-file", f"{path.name!r} is a pipe, a device or a folder: give a file")
