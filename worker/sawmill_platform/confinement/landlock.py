"""Linux's Landlock: a process gives up, for good, all files except those that it names, and the network.

Numbers and structures are from <linux/landlock.h>; rights that the kernel's version of the interface lacks are left
out.
"""

import ctypes
import errno
import os
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

# System calls, with the same number on every architecture that Python has wheels for.
CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446
ASK_VERSION, PATH_BENEATH = 1, 1
NO_NEW_PRIVILEGES = 38

WRITE_FILE, READ_FILE, READ_DIR, TRUNCATE = 1 << 1, 1 << 2, 1 << 3, 1 << 14
REMOVE_DIR, REMOVE_FILE, MAKE_DIR, MAKE_REG = 1 << 4, 1 << 5, 1 << 7, 1 << 8
READ = READ_FILE | READ_DIR
# Plain files and folders: no links, sockets, pipes or devices.
WRITE = READ | WRITE_FILE | TRUNCATE | REMOVE_DIR | REMOVE_FILE | MAKE_DIR | MAKE_REG
OF_FILES = WRITE_FILE | READ_FILE | TRUNCATE

# Numbers of the members of `Handled` by version.
_FILE_RIGHTS = {1: 13, 2: 14, 3: 15, 5: 16}
_TCP_RIGHTS = {4: 2}
_SCOPES = {6: 2}
COMPLETE = 6

_LIBC = ctypes.CDLL(None, use_errno=True)
_LIBC.syscall.restype = ctypes.c_long


class Handled(NamedTuple):
    """Bits of all that a version of the interface can restrict."""

    file_rights: int
    tcp_rights: int
    scopes: int


def handled_by(newest: int) -> Handled:
    """Return what a version of the interface can restrict; nothing else may be asked of it."""
    tables = (_FILE_RIGHTS, _TCP_RIGHTS, _SCOPES)
    counts = (max((count for since, count in table.items() if since <= newest), default=0) for table in tables)
    return Handled(*((1 << count) - 1 for count in counts))


def version() -> int:
    """Return the version of the kernel's interface; 0 if there is none, or Landlock is switched off."""
    return max(_call(CREATE_RULESET, None, 0, ASK_VERSION), 0)


def confine(readable: Iterable[Path], writable: Iterable[Path], *, held: Iterable[Path] = ()) -> None:
    """Restrict this thread, and threads that it starts, to these files and to these folders with their content.

    The kernel must have a version of the interface. Open descriptors keep their rights.

    Parameters
    ----------
    readable, writable
        Paths; missing ones are left out.
    held
        Paths that are readable too, and kept open: /proc makes files that nobody holds again at each access, and a rule
        applies to the file that existed.

    Raises
    ------
    OSError
        The kernel refuses.
    """
    handled = handled_by(version())
    attributes = struct.pack("=QQQ", *handled)
    ruleset = _checked(_call(CREATE_RULESET, attributes, len(attributes), 0))
    try:
        for paths, rights, keep in ((readable, READ, False), (held, READ, True), (writable, WRITE, False)):
            for path in paths:
                _allow(ruleset, path, rights & handled.file_rights, keep=keep)
        _checked(_LIBC.prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0))
        _checked(_call(RESTRICT_SELF, ruleset, 0))
    finally:
        os.close(ruleset)


def _allow(ruleset: int, path: Path, rights: int, *, keep: bool) -> None:
    try:
        descriptor = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except (FileNotFoundError, NotADirectoryError, PermissionError):  # what is out of reach now stays out of reach
        return
    try:
        if not path.is_dir():
            rights &= OF_FILES
        _checked(_call(ADD_RULE, ruleset, PATH_BENEATH, struct.pack("=Qi", rights, descriptor), 0))
    finally:
        if not keep:
            os.close(descriptor)


def _call(number: int, *arguments: bytes | int | None) -> int:
    words = [ctypes.c_long(argument) if isinstance(argument, int) else argument for argument in arguments]
    return int(_LIBC.syscall(ctypes.c_long(number), *words))


def _checked(answer: int) -> int:
    if answer < 0:
        number = ctypes.get_errno()
        raise OSError(number, f"Landlock: {os.strerror(number)}", errno.errorcode.get(number))
    return answer
