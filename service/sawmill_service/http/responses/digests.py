"""sha256 of the answers: entity tags and digests are made of it, and it is computed once."""

import asyncio
import hashlib
import os
import threading
from base64 import b64encode
from collections import OrderedDict
from collections.abc import Callable, Hashable
from contextlib import nullcontext
from pathlib import Path

from fastapi.concurrency import run_in_threadpool

from sawmill_platform.errors import StorageUnavailable
from sawmill_platform.files.verified_results import identity_of, regular_status

# Bytes of the pictures that are kept as they were sent; one picture may have a quarter.
_KEPT_BYTES = 16 * 1024**2
# A digest and its key have some 300 bytes.
_MOST_DIGESTS = 10_000
LARGE_FROM_BYTES = 8 * 1024**2


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
    """Digests of the newest answers by key, and small contents with their digests."""

    def __init__(self, *, large_from_bytes: int = LARGE_FROM_BYTES, read_at_once: int = 2) -> None:
        self._large_from_bytes = large_from_bytes
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

    async def of_file(self, path: Path, status: os.stat_result, compute: Callable[[Path], bytes]) -> bytes:
        """Return the digest of a file as it was when `status` was taken; the first time may take as long as reading it.

        If many requests need one file, one of them computes the digest, and the rest hold no thread.
        """
        key = (path, identity_of(status))
        if (digest := self.known(key)) is not None:
            return digest
        if key not in self._reading:
            self._reading[key] = asyncio.create_task(self._read(key, path, status, compute))
            self._reading[key].add_done_callback(lambda _: self._reading.pop(key))
        return await asyncio.shield(self._reading[key])  # a request that is cancelled leaves the task to the rest

    async def _read(self, key: Hashable, path: Path, status: os.stat_result, compute: Callable[[Path], bytes]) -> bytes:
        async with nullcontext() if status.st_size < self._large_from_bytes else self._large:
            digest = await run_in_threadpool(compute, path)
        if identity_of(regular_status(path)) != identity_of(status):
            raise StorageUnavailable(f"{path.name} was replaced while it was read: ask for it again")
        with self._lock:
            self._note(key, digest)
        return digest

    def _note(self, key: Hashable, digest: bytes) -> None:
        self._digests[key] = digest
        if len(self._digests) > _MOST_DIGESTS:
            self._digests.popitem(last=False)
