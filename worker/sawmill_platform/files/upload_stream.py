"""A file that is written as it arrives: limited in size, counted, hashed, and never in the disk's reserve."""

import asyncio
import hashlib
import os
import shutil
import time
from collections.abc import AsyncIterable, AsyncIterator, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Protocol

from sawmill_platform.errors import StorageFull, UploadTooLarge, disk_outage_reported

# Bytes passed to a thread at once: for each upload at most twice this number is in memory.
PART_BYTES = 256 * 2**10
# On a slow line, bytes are passed to the thread after this time at the latest.
_PART_S = 1.0
# Bytes between two checks of the disk. They are flushed then, so that no other write waits long for them.
STEP_BYTES = 16 * 2**20


@dataclass(frozen=True)
class Received:
    """An upload that is complete and durable, but has no owner yet; `upload_id` is set if it was sent in parts."""

    path: Path
    size_bytes: int
    sha256: str
    upload_id: str | None = None


class Content(Protocol):
    """Decoder of the bytes that were sent; its methods are called in a thread."""

    def take(self, part: bytes) -> Iterable[bytes]:
        """Return the file's bytes in a part of the body."""

    def end(self) -> None:
        """Refuse a body that is not complete."""


class AsSent:
    """Decoder of a body that is the file's bytes."""

    def take(self, part: bytes) -> Iterable[bytes]:
        """Return the part itself."""
        return (part,)

    def end(self) -> None:
        """Accept the end: nothing can be missing."""


class Arriving:
    """A new file."""

    def __init__(self, path: Path, *, max_bytes: int, reserve_bytes: int = 0) -> None:
        self._path = path
        self._max_bytes, self._reserve_bytes = max_bytes, reserve_bytes
        self._size, self._next_step = 0, STEP_BYTES
        self._hash = hashlib.sha256()
        with disk_outage_reported("the upload"):
            self._file: BinaryIO = path.open("xb")

    def write(self, chunk: bytes) -> None:
        """Write the next bytes."""
        self._size += len(chunk)
        if self._size > self._max_bytes:
            raise UploadTooLarge(self._max_bytes)
        with disk_outage_reported("the upload"):
            self._file.write(chunk)
            if self._size >= self._next_step:
                self._next_step = self._size + STEP_BYTES
                self._file.flush()
                os.fdatasync(self._file.fileno())
                check_free(self._path.parent, self._reserve_bytes, needed_by="SAWMILL_DISK_RESERVE_BYTES")
        self._hash.update(chunk)

    def take(self, content: Content, part: bytes) -> None:
        """Decode a part and write it."""
        for chunk in content.take(part):
            self.write(chunk)

    def take_last(self, content: Content, part: bytes) -> Received:
        """Write the last part and end."""
        self.take(content, part)
        return self.finish(content)

    def finish(self, content: Content) -> Received:
        """Make the file durable, if it is complete."""
        content.end()
        with disk_outage_reported("the upload"):
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
        return Received(self._path, self._size, self._hash.hexdigest())

    def abandon(self) -> None:
        """Remove the file."""
        with disk_outage_reported("the upload"):
            self._path.unlink(missing_ok=True)
            self._file.close()


async def receive_in_threads(arriving: Arriving, chunks: AsyncIterable[bytes], content: Content) -> Received:
    """Write an upload in threads: neither the disk nor the digests keep other requests waiting."""
    last = b""  # written together with the end, it takes one thread, not two: most bodies are one part
    try:
        async for part in in_parts(chunks):
            if last:
                await asyncio.to_thread(arriving.take, content, last)
            last = part
        return await asyncio.to_thread(arriving.take_last, content, last)
    except Exception:
        await asyncio.to_thread(arriving.abandon)
        raise
    except BaseException:  # a cancelled upload may not wait for a thread
        arriving.abandon()
        raise


async def in_parts(chunks: AsyncIterable[bytes]) -> AsyncIterator[bytes]:
    """Yield the same bytes in parts of about `PART_BYTES`, or of what arrives in a second; the last part as it is."""
    part, given_s = bytearray(), time.monotonic()
    try:
        async for chunk in chunks:
            part += chunk
            if len(part) >= PART_BYTES or (part and time.monotonic() - given_s > _PART_S):
                yield bytes(part)
                part.clear()
                given_s = time.monotonic()
    except Exception:  # the upload was broken off: the bytes before that are not lost
        yield bytes(part)
        raise
    if part:
        yield bytes(part)


def check_free(folder: Path, reserve_bytes: int, *, needed_by: str) -> None:
    """Check that this number of bytes is free on a folder's disk."""
    with disk_outage_reported("measuring the disk"):
        free = shutil.disk_usage(folder).free
    if free < reserve_bytes:
        raise StorageFull(
            f"the disk is full: {free} bytes are free in the data folder, and {needed_by} needs {reserve_bytes}; "
            "free some space"
        )
