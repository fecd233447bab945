"""Linux's capabilities, root's single rights: a process gives them up for good.

Numbers and structures are those of <linux/capability.h> and <linux/prctl.h>.
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
    """Leave this thread, and those that it starts, no capability, and no program that could give it one.

    Raises
    ------
    OSError
        The kernel refuses.
    """
    _LIBC.prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    # Refused to whoever has no capability to drop, and for numbers that the kernel does not know.
    for capability in range(MOST):
        _LIBC.prctl(DROP_FROM_BOUNDING_SET, capability, 0, 0, 0)
    _LIBC.prctl(AMBIENT, CLEAR_ALL, 0, 0, 0)
    # Of this thread; the sets effective, permitted and inheritable, each in two halves.
    if _LIBC.capset(struct.pack("=Ii", VERSION_3, 0), struct.pack("=6I", *[0] * 6)) != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"capset: {os.strerror(number)}")
