"""The template: a process that has imported everything, computes nothing more, and forks a child for each attempt.

The template is a child of the supervisor (module `template`). Requests come over an inherited socket, one in a packet.
Each packet brings three descriptors: the child's standard input, its channel (module `protocol`) and its book. The book
is a pipe into which the template writes two lines: the child's process id and, when the child and all processes that it
started have ended, its exit code.
"""

import ctypes
import gc
import mmap
import os
import re
import selectors
import signal
import socket
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

import structlog

REQUESTS = "SAWMILL_ATTEMPT_REQUESTS"
TBB = "SAWMILL_ATTEMPT_TBB"
WARM = b"warm"
# <linux/prctl.h>: orphans among a process's descendants become its children.
SET_CHILD_SUBREAPER = 36
# A part of a file that is mapped to be read or run, without a page that was changed: in proc(5)'s smaps.
_UNCHANGED_FILE = re.compile(r"^(\w+)-(\w+) r-.p \w+ \w+:\w+ [1-9].*\n(?:[A-Z].*\n)*?Anonymous: +0 kB$", re.MULTILINE)

AttemptMain = Callable[[BinaryIO], None]


def serve(requests: socket.socket, attempt: AttemptMain) -> None:
    """Fork a child for each request until the supervisor is gone.

    Parameters
    ----------
    requests
        Socket from the supervisor. When the socket is closed, the template ends; a child ends when its standard input
        is closed.
    attempt
        Main function of a child, called with the child's channel; the supervisor's assignment waits on standard input.
    """
    gc.collect()
    give_back_memory()
    # All present objects live as long as the process: a child's collector need not visit them, and so copies no pages.
    gc.freeze()
    ctypes.CDLL(None).prctl(SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    children = _Children(requests)
    with suppress(ConnectionError):  # the supervisor is gone already
        requests.send(WARM)
    while descriptors := children.next_request():
        children.fork(attempt, *descriptors)


class _Children:
    """Running children: the book of each, by a descriptor that becomes readable when the child ends."""

    def __init__(self, requests: socket.socket) -> None:
        self._requests = requests
        self._events = selectors.DefaultSelector()
        self._events.register(requests, selectors.EVENT_READ)

    def next_request(self) -> list[int]:
        """Return the descriptors of the next request, none once the supervisor is gone; enter the ends of children."""
        while True:
            for key, _ in self._events.select():
                if key.data is not None:
                    self._enter_end(key.fd, *key.data)
                    continue
                try:
                    return socket.recv_fds(self._requests, 16, 3)[1]
                except ConnectionError:  # as when the socket had not yet read what was sent
                    return []

    def fork(self, attempt: AttemptMain, assignment: int, channel: int, book: int) -> None:
        """Start a child; if the system refuses, the supervisor sees its pipes close."""
        try:
            process_id = os.fork()
        except OSError:
            structlog.get_logger().exception("fork-refused")
            os.close(book)
        else:
            if process_id == 0:
                os.close(book)
                self._become_child(assignment, channel, attempt)
            _enter(book, process_id)
            self._events.register(os.pidfd_open(process_id), selectors.EVENT_READ, (process_id, book))
        os.close(assignment)
        os.close(channel)

    def _enter_end(self, descriptor: int, process_id: int, book: int) -> None:
        self._events.unregister(descriptor)
        os.close(descriptor)
        _, status = os.waitpid(process_id, 0)
        # The processes that ended attempts have left are killed; the end of one may leave more.
        attempts = {key.data[0] for key in self._events.get_map().values() if key.data is not None}
        while orphans := _children() - attempts:
            for orphan in orphans:
                os.kill(orphan, signal.SIGKILL)
                os.waitpid(orphan, 0)
        _enter(book, os.waitstatus_to_exitcode(status))
        os.close(book)

    def _become_child(self, assignment: int, channel: int, attempt: AttemptMain) -> None:
        """Run the attempt in a new session and end, without the descriptors of the template and of other children."""
        code = 1
        try:
            os.setsid()
            os.dup2(assignment, 0)
            os.close(assignment)
            for key in list(self._events.get_map().values()):
                os.close(key.fd)
                if key.data is not None:
                    os.close(key.data[1])
            self._events.close()
            if "numpy.random" in sys.modules:  # whose generator all children would share; Python seeds its own
                sys.modules["numpy.random"].seed()
            with open(channel, "wb", buffering=0) as opened:
                attempt(opened)
            code = 0
        except BaseException:  # noqa: BLE001 - a child must never come back into the template's loop
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)  # the template's own ending is not the child's to do


def give_back_memory() -> None:
    """Return to the system the memory that imports and warming up have used: free heap, some 9 MiB, and library pages.

    Pages that equal their file stay in the system's cache, where a process that needs one finds it. A child begins
    without them in any case. The pages of LLVM, which loads kernels, are 67 MiB.
    """
    libc = ctypes.CDLL(None)
    with suppress(AttributeError):  # glibc's alone
        libc.malloc_trim(0)
    for mapping in _UNCHANGED_FILE.finditer(Path("/proc/self/smaps").read_text()):
        start, end = (int(address, 16) for address in mapping.groups())
        libc.madvise(ctypes.c_void_p(start), ctypes.c_size_t(end - start), mmap.MADV_DONTNEED)


def _children() -> set[int]:
    """Return the ids of this process's children; none on a kernel that does not list them."""
    with suppress(FileNotFoundError):
        return {int(word) for word in Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()}
    return set()


def _enter(book: int, number: int) -> None:
    with suppress(BrokenPipeError):  # the supervisor has let go of it
        os.write(book, b"%d\n" % number)
