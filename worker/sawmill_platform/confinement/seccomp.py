"""Linux's seccomp: system calls that a process no longer needs fail from now on, for good and in all threads.

The filter complements `landlock`, which restricts only TCP among the ways to communicate, and not the modes and times
of files. Numbers are from <asm/unistd.h>, the program is classic BPF as in <linux/filter.h> and <linux/seccomp.h>.
"""

import ctypes
import errno
import os
import platform
import struct
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

SET_FILTER, ALL_THREADS, NO_SPECULATION_CHANGE = 1, 1, 4
NO_NEW_PRIVILEGES = 38
ALLOW, FAIL = 0x7FFF0000, 0x00050000
# Load a word of the call's description; jump if the word equals, is at least, or has a bit of, a number; return.
LOAD, JUMP_EQUAL, JUMP_AT_LEAST, JUMP_BIT, RETURN = 0x20, 0x15, 0x35, 0x45, 0x06
# The last is the lower half of the first argument, at the same place on both machines: calls below use only this half.
NUMBER, ARCHITECTURE, FIRST_ARGUMENT = 0, 4, 16
# From this number on, x86-64 has the same calls with other numbers, for another ABI.
OTHER_ABI = 0x40000000


class _Machine(NamedTuple):
    column: int
    architecture: int
    seccomp: int


_MACHINES = MappingProxyType({"x86_64": _Machine(0, 0xC000003E, 317), "aarch64": _Machine(1, 0xC00000B7, 277)})
# Numbers by architecture; None if the architecture has no such call.
_CALLS: Mapping[str, tuple[int | None, int | None]] = MappingProxyType(
    {
        # Communication.
        "socket": (41, 198),
        "socketpair": (53, 199),
        "sendto": (44, 206),
        "sendmsg": (46, 211),
        "sendmmsg": (307, 269),
        "connect": (42, 203),
        "bind": (49, 200),
        "listen": (50, 201),
        "accept": (43, 202),
        "accept4": (288, 242),
        # Access to other processes.
        "ptrace": (101, 117),
        "process_vm_readv": (310, 270),
        "process_vm_writev": (311, 271),
        "pidfd_getfd": (438, 438),
        # Programs, and other processes, which would outlive this one or leave its group.
        "execve": (59, 221),
        "execveat": (322, 281),
        "fork": (57, None),
        "vfork": (58, None),
        "setsid": (112, 157),
        "setpgid": (109, 154),
        # Changes that slow other processes of the same user down; own affinity is among the conditions below.
        "setpriority": (141, 140),
        "ioprio_set": (251, 30),
        "sched_setparam": (142, 118),
        "sched_setscheduler": (144, 119),
        "sched_setattr": (314, 274),
        # Changes to a file's metadata.
        "chmod": (90, None),
        "fchmod": (91, 52),
        "fchmodat": (268, 53),
        "fchmodat2": (452, 452),
        "chown": (92, None),
        "fchown": (93, 55),
        "lchown": (94, None),
        "fchownat": (260, 54),
        "utime": (132, None),
        "utimes": (235, None),
        "futimesat": (261, None),
        "utimensat": (280, 88),
        "setxattr": (188, 5),
        "lsetxattr": (189, 6),
        "fsetxattr": (190, 7),
        "removexattr": (197, 14),
        "lremovexattr": (198, 15),
        "fremovexattr": (199, 16),
        # Other ways out, or into the kernel.
        "mount": (165, 40),
        "unshare": (272, 97),
        "setns": (308, 268),
        "io_uring_setup": (425, 425),
        "bpf": (321, 280),
        "userfaultfd": (323, 282),
        "perf_event_open": (298, 241),
        "add_key": (248, 217),
        "request_key": (249, 218),
        "keyctl": (250, 219),
        # Memory and queues that would outlive the process or that no limit counts.
        "memfd_create": (319, 279),
        "memfd_secret": (447, 447),
        "shmget": (29, 194),
        "semget": (64, 190),
        "msgget": (68, 186),
        "mq_open": (240, 180),
    }
)


class _Condition(NamedTuple):
    """A call that is allowed by its first argument: if the jump's test of the argument has the given outcome."""

    numbers: tuple[int, int]
    jump: int
    operand: int
    allowed_if: bool


# <linux/sched.h>, <sys/prctl.h>
CLONE_THREAD, SET_DUMPABLE = 0x10000, 4
_CONDITIONS = (
    _Condition((56, 220), JUMP_BIT, CLONE_THREAD, allowed_if=True),  # clone: threads, no processes
    _Condition((157, 167), JUMP_EQUAL, SET_DUMPABLE, allowed_if=False),  # prctl: its supervisor sees its open files
    _Condition((302, 261), JUMP_EQUAL, 0, allowed_if=True),  # prlimit64: its own limits, not the service's
    _Condition((203, 122), JUMP_EQUAL, 0, allowed_if=True),  # sched_setaffinity: the calling thread's, as TBB does
)
# The flags of clone3 are in memory, which no filter reads; if clone3 is not implemented, the C library calls clone.
_CLONE3 = 435

_LIBC = ctypes.CDLL(None, use_errno=True)
_LIBC.syscall.restype = ctypes.c_long


class _Program(ctypes.Structure):
    _fields_ = (("length", ctypes.c_ushort), ("instructions", ctypes.c_char_p))


def refuse_calls() -> bool:
    """Let the calls fail with EACCES, as calls that are not permitted; calls of other architectures too.

    From then on this process can start threads alone: it stays one process for good.

    Returns
    -------
    bool
        False if the machine or the kernel is not supported: then nothing has changed.

    Raises
    ------
    OSError
        The kernel refuses.
    """
    machine = _MACHINES.get(platform.machine())
    if machine is None:
        return False
    instructions = _instructions(machine)
    program = _Program(len(instructions) // 8, instructions)
    _LIBC.prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    words = (machine.seccomp, SET_FILTER, ALL_THREADS | NO_SPECULATION_CHANGE)
    if _LIBC.syscall(*map(ctypes.c_long, words), ctypes.byref(program)) == 0:
        return True
    number = ctypes.get_errno()
    if number in {errno.ENOSYS, errno.EINVAL}:  # seccomp is switched off, or older than the flags
        return False
    raise OSError(number, f"seccomp: {os.strerror(number)}")


def _instructions(machine: _Machine) -> bytes:
    refused = sorted(number for each in _CALLS.values() if (number := each[machine.column]) is not None)
    lines: list[tuple[int, int | str, int | str, int]] = [
        (LOAD, 0, 0, ARCHITECTURE),
        (JUMP_EQUAL, 0, "refuse", machine.architecture),
        (LOAD, 0, 0, NUMBER),
        (JUMP_AT_LEAST, "refuse", 0, OTHER_ABI),
        *((JUMP_EQUAL, "refuse", 0, number) for number in refused),
        (JUMP_EQUAL, "lack", 0, _CLONE3),
    ]
    for numbers, jump, operand, allowed_if in _CONDITIONS:
        outcomes = ("allow", "refuse") if allowed_if else ("refuse", "allow")
        lines += [(JUMP_EQUAL, 0, 2, numbers[machine.column]), (LOAD, 0, 0, FIRST_ARGUMENT), (jump, *outcomes, operand)]
    returns = {"allow": ALLOW, "refuse": FAIL | errno.EACCES, "lack": FAIL | errno.ENOSYS}
    places = {name: len(lines) + number for number, name in enumerate(returns)}

    def skipped(target: int | str, place: int) -> int:
        """Count the instructions that a jump skips."""
        return target if isinstance(target, int) else places[target] - place - 1

    jumps = [(code, skipped(yes, at), skipped(no, at), word) for at, (code, yes, no, word) in enumerate(lines)]
    return b"".join(
        struct.pack("=HBBI", *line) for line in [*jumps, *((RETURN, 0, 0, word) for word in returns.values())]
    )
