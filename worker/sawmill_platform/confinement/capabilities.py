"""Linux's capabilities, the single rights of root: a process gives them up for good.

Numbers and structures are from <linux/capability.h> and <linux/prctl.h>.
"""

import ctypes
import os
import struct

NO_NEW_PRIVILEGES, DROP_FROM_BOUNDING_SET, AMBIENT, CLEAR_ALL = 38, 24, 47, 4
VERSION_3 = 0x20080522
# The kernel knows 41; the sets have room for this many.
MOST = 64

_LIBC = ctypes.CDLL(None, use_errno=True)


def drop_all() -> None:
    """Drop all capabilities of this thread and of threads that it starts, and forbid programs that could restore one.

    Raises
    ------
    OSError
        The kernel refuses.
    """
    _LIBC.prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    # Refused to a thread that has no capability to drop, and for numbers that the kernel does not know.
    for capability in range(MOST):
        _LIBC.prctl(DROP_FROM_BOUNDING_SET, capability, 0, 0, 0)
    _LIBC.prctl(AMBIENT, CLEAR_ALL, 0, 0, 0)
    # Sets of this thread: effective, permitted and inheritable, each in two halves.
    if _LIBC.capset(struct.pack("=Ii", VERSION_3, 0), struct.pack("=6I", *[0] * 6)) != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"capset: {os.strerror(number)}")
