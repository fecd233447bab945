"""Parts of uploads that this process receives: a later request about an upload ends the earlier part.

A client sends one part of an upload at a time. Its later request shows that the connection of the earlier one has
broken, which the service may not have noticed yet (draft-ietf-httpbis-resumable-upload, "Concurrency").
"""

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import asynccontextmanager

import anyio

from sawmill_platform.errors import Busy


class Transfer:
    """A part of an upload that is being received."""

    def __init__(self, upload_id: str) -> None:
        self.over = asyncio.Event()
        self._upload_id, self._is_ended = upload_id, False
        self._wait = anyio.CancelScope()

    async def until_ended(self, chunks: AsyncGenerator[bytes]) -> AsyncIterator[bytes]:
        """Yield a body's chunks as they arrive."""
        chunk: bytes | None = b""
        while chunk is not None:
            if chunk:
                yield chunk
            with anyio.CancelScope() as self._wait:
                chunk = None if self._is_ended else await anext(chunks, None)
            if self._is_ended:
                msg = f"a later request about upload {self._upload_id!r} has ended this part: ask for the offset"
                raise Busy("upload-busy", msg)

    async def end(self) -> None:
        """Stop waiting for the body, and return once the received bytes are counted."""
        self._is_ended = True
        self._wait.cancel()
        await self.over.wait()


class Transfers:
    """Current transfers by upload; used by one event loop."""

    def __init__(self) -> None:
        self._coming: dict[str, Transfer] = {}

    async def end(self, upload_id: str) -> None:
        """End the part of an upload that is being received, if there is one."""
        while transfer := self._coming.get(upload_id):
            await transfer.end()

    @asynccontextmanager
    async def begin(self, upload_id: str) -> AsyncIterator[Transfer]:
        """End the earlier part of an upload, and register the new part within the block."""
        await self.end(upload_id)
        transfer = self._coming[upload_id] = Transfer(upload_id)
        try:
            yield transfer
        finally:
            del self._coming[upload_id]
            transfer.over.set()
