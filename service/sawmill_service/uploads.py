"""Bodies that are streamed, never held in memory as a whole, and files that are used again."""

from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import Request
from fastapi.concurrency import run_in_threadpool
from pydantic import Field

from sawmill_service.problems import Refused
from sawmill_worker.contracts.base import Identifier
from sawmill_worker.storage.files import Received
from sawmill_worker.storage.store import Store

InspectionId = Annotated[
    Identifier | None,
    Field(description="Takes the file of this inspection: the body is empty, and nothing is sent again."),
]


async def received_file(request: Request, store: Store, inspection_id: str | None, *, max_bytes: int) -> Received:
    """The file in the body, or that of an inspection; whoever accepts it owns or discards it.

    Raises
    ------
    Refused
        The body is empty and no inspection is named, or both are given.
    NotFound, Conflict
        There is no such inspection, or its file has been removed.
    """
    if inspection_id is None:
        return await store.files.receive_stream(chunks(request), max_bytes=max_bytes)
    async for chunk in request.stream():
        if chunk:
            raise Refused(
                422, "two-files", "send a file or name an inspection_id: the body has bytes, and one is named"
            )
    return await run_in_threadpool(store.inspections.received_again, inspection_id)


async def chunks(request: Request) -> AsyncIterator[bytes]:
    """The body's bytes as they come, refusing an empty body and one that has another length than declared.

    The gate bounds the total; a client that goes away raises `ClientDisconnect`.
    """
    received = 0
    async for chunk in request.stream():
        received += len(chunk)
        if chunk:
            yield chunk
    declared = request.headers.get("content-length")
    if received == 0:
        raise Refused(422, "empty-body", "the body is empty: send the file's bytes as the body")
    if declared is not None and int(declared) != received:
        raise Refused(400, "bad-length", f"Content-Length says {declared} bytes, but {received} came")
