"""Bodies that are streamed, never held in memory as a whole."""

from collections.abc import AsyncIterator

from fastapi import Request

from sawmill_service.problems import Refused


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
