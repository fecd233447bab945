"""Request bodies that are streamed, never held in memory as a whole, and files that are used again."""

import asyncio
import hashlib
from collections.abc import AsyncIterator, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request
from fastapi.concurrency import run_in_threadpool
from pydantic import Field

from sawmill_platform.contracts.base import Identifier
from sawmill_platform.contracts.given import Given
from sawmill_platform.contracts.jobs import Priority
from sawmill_platform.errors import UploadTooLarge
from sawmill_platform.files.upload_stream import Received, in_parts
from sawmill_platform.uploads.upload_store import Uploads
from sawmill_service.dependencies import TheStore
from sawmill_service.http.bodies.body_sums import BodySums
from sawmill_service.http.bodies.sent_content import FirstBytes, SentContent, empty_body
from sawmill_service.http.problems import Refused
from sawmill_service.http.responses.answers import RequestPriority
from sawmill_store.scans.scans import Inspections

# Repeated files are not urgent: they do not take the threads of other requests.
_REPEATS = ThreadPoolExecutor(2, "repeats")

InspectionId = Annotated[
    Identifier | None,
    Field(description="Id of an inspection whose file is used: the body is empty, and nothing is sent again."),
]
UploadId = Annotated[
    Identifier | None,
    Field(description="Id of an upload in parts that is used: the body is empty, and the upload is used up."),
]


class FileQuery(Given):
    """Part of a query that names an earlier file, or none where the file is in the body, and the job's priority."""

    priority: RequestPriority = Priority.INTERACTIVE
    inspection_id: InspectionId = None
    upload_id: UploadId = None

    @property
    def sends_file(self) -> bool:
        """True if the file is in the body."""
        return self.inspection_id is None and self.upload_id is None


@dataclass(frozen=True)
class Reception:
    """Reception of the file of a request."""

    request: Request
    inspections: Inspections
    uploads: Uploads

    async def file(self, inspection_id: str | None, upload_id: str | None, *, max_bytes: int) -> Received:
        """Receive the file in the body, or take an earlier one; the code that accepts the file owns or discards it."""
        if inspection_id is None and upload_id is None:
            return await self._body(max_bytes)
        if inspection_id is not None and upload_id is not None:
            raise Refused(422, "two-files", "name an inspection_id or an upload_id: both are given")
        await check_no_file(self.request)
        if inspection_id is not None:
            return await run_in_threadpool(self.inspections.received_again, inspection_id)
        received = await run_in_threadpool(self.uploads.received, str(upload_id))
        try:
            await run_in_threadpool(_check, received, max_bytes)
        except Exception:
            self.uploads.files.discard(received)
            raise
        return received

    async def _body(self, max_bytes: int) -> Received:
        """Receive the file in the body; what the head alone shows to be wrong is refused before a byte is read."""
        content = SentContent(self.request.headers)
        reserve_bytes = await run_in_threadpool(self.uploads.check_room_for, declared_bytes(self.request))
        return await self.uploads.files.receive_stream(
            chunks(self.request), max_bytes=max_bytes, reserve_bytes=reserve_bytes, content=content
        )


async def _reception(request: Request, store: TheStore) -> Reception:
    return Reception(request, store.inspections, store.uploads)


TheReception = Annotated[Reception, Depends(_reception)]


async def check_no_file(request: Request) -> None:
    """Refuse a body next to the name of an earlier file, and a digest that is not the digest of no bytes."""
    if getattr(request.state, "has_no_file", False):
        return
    request.state.body_begun = True
    sums = BodySums(request.headers)
    async for chunk in request.stream():
        if chunk:
            raise Refused(422, "two-files", "send a file or name an earlier one: the body has bytes, and one is named")
    sums.check()
    request.state.body_begun, request.state.has_no_file = False, True


def _check(received: Received, max_bytes: int) -> None:
    if received.size_bytes > max_bytes:
        raise UploadTooLarge(max_bytes)
    with received.path.open("rb") as file:
        FirstBytes().look(file.read(FirstBytes.NUMBER))


async def body_sha256(request: Request, *, max_bytes: int) -> str:
    """Compute the SHA-256 of the file in the body, which is not kept; refuse the body like `Reception.file`."""
    size, digest, content = 0, hashlib.sha256(), SentContent(request.headers)
    loop = asyncio.get_running_loop()
    async for part in in_parts(chunks(request)):
        size += await loop.run_in_executor(_REPEATS, _add, digest, content.take(part))
        if size > max_bytes:
            raise UploadTooLarge(max_bytes)
    await loop.run_in_executor(_REPEATS, content.end)
    return digest.hexdigest()


def _add(digest: "hashlib._Hash", pieces: Iterable[bytes]) -> int:
    size = 0
    for piece in pieces:
        digest.update(piece)
        size += len(piece)
    return size


def declared_bytes(request: Request) -> int:
    """Return the length that the head declares, bytes; 0: none."""
    return int(request.headers.get("content-length", "0"))  # digits: the gate has checked


async def chunks(request: Request) -> AsyncIterator[bytes]:
    """Yield the bytes of the body as they come; refuse an empty body and one that has another length than declared.

    The gate bounds the total; a client that goes away raises `ClientDisconnect`.
    """
    if request.headers.get("content-length") == "0":
        raise empty_body()
    request.state.body_begun = True
    received = 0
    async for chunk in request.stream():
        received += len(chunk)
        if chunk:
            yield chunk
    if received == 0:
        raise empty_body()
    if declared_bytes(request) not in {0, received}:
        raise Refused(400, "bad-length", f"Content-Length says {declared_bytes(request)} bytes, but {received} came")


def body_begun(request: Request) -> bool:
    """Return whether `chunks` or `check_no_file` has read a part of a body that was not found empty."""
    return getattr(request.state, "body_begun", False)
