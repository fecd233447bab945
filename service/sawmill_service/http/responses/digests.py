"""sha256 of the answers: entity tags and digests are made of it, and it is computed once."""

import asyncio
import hashlib
import os
import threading
from base64 import b64encode
from collections import OrderedDict
from collections.abc import Callable, Hashable
from pathlib import Path

import structlog
from fastapi.concurrency import run_in_threadpool

from sawmill_formats.errors import DamagedResult
from sawmill_platform.files.digests import NOTED_FROM_BYTES, compute_digest, note_digest, read_note

# Bytes of the pictures that are kept as they were sent; one picture may have a quarter.
_KEPT_BYTES = 16 * 1024**2
# A digest and its key have some 300 bytes.
_MOST_DIGESTS = 10_000

log = structlog.get_logger(__name__)


def tag_of(digest: bytes) -> str:
    """Return a strong entity tag."""
    return f'"{digest.hex()}"'


def repr_digest(digest: bytes) -> str:
    """Return the value of the header `Repr-Digest` (RFC 9530)."""
    return f"sha-256=:{b64encode(digest).decode()}:"


def key_of(path: str, made_of: Hashable) -> Hashable:
    """Return the key of a content that is made for a path from further values, which may be long."""
    return path, hashlib.sha256(repr(made_of).encode()).digest()


class Digests:
    """Digests of the newest answers by key, and small contents with their digests.

    Parameters
    ----------
    noted_from_bytes
        Size from which a file counts as large: its digest is noted next to it.
    read_at_once
        Large files that are read at once, each in a thread: the other threads remain for further requests.
    """

    def __init__(self, *, noted_from_bytes: int = NOTED_FROM_BYTES, read_at_once: int = 2) -> None:
        self._noted_from_bytes = noted_from_bytes
        self._lock = threading.Lock()
        self._reading: dict[Hashable, asyncio.Task[bytes]] = {}
        self._large = asyncio.Semaphore(read_at_once)
        self._digests: OrderedDict[Hashable, bytes] = OrderedDict()
        self._contents: OrderedDict[Hashable, bytes] = OrderedDict()
        self._kept_bytes = 0

    def known(self, key: Hashable) -> bytes | None:
        """Return the digest that was noted under a key."""
        with self._lock:
            return self._digests.get(key)

    def content(self, key: Hashable) -> bytes | None:
        """Return the content that was noted under a key, if it is still kept."""
        with self._lock:
            if key in self._contents:
                self._contents.move_to_end(key)
            return self._contents.get(key)

    def note(self, key: Hashable, content: bytes, *, keep: bool = True) -> bytes:
        """Note and return the digest of a content under a key; keep a small content with the digest."""
        digest = hashlib.sha256(content).digest()
        with self._lock:
            self._note(key, digest)
            if keep and key not in self._contents and len(content) <= _KEPT_BYTES // 4:
                self._contents[key] = content
                self._kept_bytes += len(content)
            while self._kept_bytes > _KEPT_BYTES:
                self._kept_bytes -= len(self._contents.popitem(last=False)[1])
        return digest

    def compute(self, path: Path, status: os.stat_result) -> bytes:
        """Compute a file's digest as `compute_digest` does."""
        return compute_digest(path, status)

    async def of_file(self, path: Path, status: os.stat_result, check: Callable[[], None]) -> bytes:
        """Return the digest of a file as it was when `status` was taken; the first time may take as long as reading it.

        If many requests need one file, one of them computes the digest, and the rest hold no thread.

        Raises
        ------
        FileNotFoundError
            The file is gone.
        StorageUnavailable
            The file has been replaced.
        DamagedResult
            `check` refuses the file, or its digest differs from the noted one.
        """
        key = (str(path), status.st_size, status.st_mtime_ns)
        if (digest := self.known(key)) is not None:
            return digest
        if key not in self._reading:
            self._reading[key] = asyncio.create_task(self._read(key, path, status, check))
            self._reading[key].add_done_callback(lambda _: self._reading.pop(key))
        return await asyncio.shield(self._reading[key])  # a request that is cancelled leaves the task to the rest

    async def _read(self, key: Hashable, path: Path, status: os.stat_result, check: Callable[[], None]) -> bytes:
        await run_in_threadpool(check)
        noted = await run_in_threadpool(read_note, path)
        if noted is not None and noted.is_of(status):
            digest = noted.digest
        elif status.st_size < self._noted_from_bytes:
            digest = await run_in_threadpool(self.compute, path, status)
        else:
            async with self._large:
                digest = await run_in_threadpool(self.compute, path, status)
        if noted is not None and noted.digest != digest:
            raise DamagedResult(path.name, "its digest is not the one that was taken when it was written")
        if status.st_size >= self._noted_from_bytes and (noted is None or not noted.is_of(status)):
            await run_in_threadpool(_keep, path, status, digest)
        with self._lock:
            self._note(key, digest)
        return digest

    def _note(self, key: Hashable, digest: bytes) -> None:
        self._digests[key] = digest
        if len(self._digests) > _MOST_DIGESTS:
            self._digests.popitem(last=False)


def _keep(path: Path, status: os.stat_result, digest: bytes) -> None:
    try:
        note_digest(path, status, digest)
    except OSError as error:  # a full disk: the file can be sent all the same
        log.warning("digest-not-kept", file=path.name, reason=str(error))
