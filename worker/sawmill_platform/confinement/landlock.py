"""Linux's Landlock: a process takes from itself, for good, all files but those that it names, and the network.

Numbers and structures are those of <linux/landlock.h>; what a kernel lacks by its version of the interface is left out.
"""

import ctypes
import errno
import os
import struct
from collections.abc import Iterable
from pathlib import Path

# System calls, of the same number on every architecture that Python has wheels for.
CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446
ASK_VERSION, PATH_BENEATH = 1, 1
NO_NEW_PRIVILEGES = 38

WRITE_FILE, READ_FILE, READ_DIR, TRUNCATE = 1 << 1, 1 << 2, 1 << 3, 1 << 14
REMOVE_DIR, REMOVE_FILE, MAKE_DIR, MAKE_REG = 1 << 4, 1 << 5, 1 << 7, 1 << 8
READ = READ_FILE | READ_DIR
# Plain files and folders: no links, sockets, pipes or devices.
WRITE = READ | WRITE_FILE | TRUNCATE | REMOVE_DIR | REMOVE_FILE | MAKE_DIR | MAKE_REG
OF_FILES = WRITE_FILE | READ_FILE | TRUNCATE

# From a version on: how many of the rights to files there are, of those to TCP (to bind, to connect), and of the scopes
# beyond which nothing is reached (abstract Unix sockets, signals).
_FILE_RIGHTS = {1: 13, 2: 14, 3: 15, 5: 16}
_TCP_RIGHTS = {4: 2}
_SCOPES = {6: 2}
COMPLETE = 6

_LIBC = ctypes.CDLL(None, use_errno=True)
_LIBC.syscall.restype = ctypes.c_long


def version() -> int:
    """Of the kernel's interface; 0 where there is none, or where it is switched off."""
    return max(_call(CREATE_RULESET, None, 0, ASK_VERSION), 0)


def confine(readable: Iterable[Path], writable: Iterable[Path], *, held: Iterable[Path] = ()) -> None:
    """Leave this thread, and those that it starts, nothing but these files and folders with all below them.

    There must be a version. Descriptors that are open keep their rights.

    Parameters
    ----------
    readable, writable
        What is not there is left out.
    held
        Readable too, and kept open: /proc makes what nobody holds anew, and a rule holds for what there was.

    Raises
    ------
    OSError
        The kernel refuses.
    """
    newest = version()
    handled = _bits(_FILE_RIGHTS, newest)
    attributes = struct.pack("=QQQ", handled, _bits(_TCP_RIGHTS, newest), _bits(_SCOPES, newest))
    ruleset = _checked(_call(CREATE_RULESET, attributes, len(attributes), 0))
    try:
        for paths, rights, keep in ((readable, READ, False), (held, READ, True), (writable, WRITE, False)):
            for path in paths:
                _allow(ruleset, path, rights & handled, keep=keep)
        _checked(_LIBC.prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0))
        _checked(_call(RESTRICT_SELF, ruleset, 0))
    finally:
        os.close(ruleset)


def _allow(ruleset: int, path: Path, rights: int, *, keep: bool) -> None:
    try:
        descriptor = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except (FileNotFoundError, NotADirectoryError, PermissionError):  # what is not reached now is not reached then
        return
    try:
        if not path.is_dir():
            rights &= OF_FILES
        rule = struct.pack("=Qi", rights, descriptor)
        _checked(_call(ADD_RULE, ruleset, PATH_BENEATH, rule, 0))
    finally:
        if not keep:
            os.close(descriptor)


def _bits(counts: dict[int, int], newest: int) -> int:
    return (1 << max((count for since, count in counts.items() if since <= newest), default=0)) - 1


def _call(number: int, *arguments: bytes | int | None) -> int:
    words = [ctypes.c_long(argument) if isinstance(argument, int) else argument for argument in arguments]
    answer: int = _LIBC.syscall(ctypes.c_long(number), *words)
    return answer


def _checked(answer: int) -> int:
    if answer < 0:
        number = ctypes.get_errno()
        raise OSError(number, f"Landlock: {os.strerror(number)}", errno.errorcode.get(number))
    return answer
