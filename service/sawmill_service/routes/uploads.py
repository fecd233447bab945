"""/v1/uploads: files that are sent in parts, by the draft "Resumable Uploads for HTTP" of the IETF."""

import asyncio
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor

from fastapi import Request, Response
from fastapi.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from sawmill_platform.contracts.base import Identifier
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.contracts.uploads import Upload, UploadRequest, UploadState
from sawmill_platform.errors import Busy, UploadTooLarge
from sawmill_platform.files.upload_stream import in_parts
from sawmill_platform.uploads.upload_parts import UploadPart
from sawmill_platform.uploads.upload_store import UploadQuota, Uploads, WrongOffset
from sawmill_service.dependencies import TheCaller, TheSettings, TheStore, TheTransfers
from sawmill_service.http.bodies.body_sums import HEADERS, AnnouncedPart, announced_part
from sawmill_service.http.bodies.sent_content import BYTES, SentContent
from sawmill_service.http.bodies.sent_json import Sent
from sawmill_service.http.document.described_answers import offset_answered, refuses, refuses_upload, with_some
from sawmill_service.http.document.openapi_document import trying, trying_file
from sawmill_service.http.problems import Refused
from sawmill_service.http.repeats import repeatable
from sawmill_service.http.route_rules import Router

router = Router(prefix="/v1/uploads", tags=["uploads"], reading=Scope.READ)
# Computing the digest of a large file takes as long as reading it; the threads that write files do not wait for that.
_SUMS = ThreadPoolExecutor(2, "sums-of-uploads")


@router.post(
    "",
    needs=Scope.SUBMIT,
    status_code=201,
    summary="Start an upload that can be resumed",
    responses=offset_answered(201, "Location") | refuses("upload-too-large", "upload-quota"),
    openapi_extra=trying(body={"size_bytes": 65536, "name": "mill.h5"}),
)
@repeatable
def create_upload(ask: Sent[UploadRequest], store: TheStore, settings: TheSettings, response: Response) -> Upload:
    """Declare a file; its bytes follow with `PATCH`. Disk space is reserved until a day after the last part."""
    if ask.size_bytes > settings.max_upload_bytes:
        raise UploadTooLarge(settings.max_upload_bytes)
    store.uploads.check_room_for(ask.size_bytes)
    upload = store.uploads.create(
        ask,
        UploadQuota(
            settings.max_waiting_uploads, settings.max_waiting_upload_bytes, settings.max_all_waiting_upload_bytes
        ),
    )
    response.headers["Location"] = f"/v1/uploads/{upload.id}"
    return _with_headers(response, upload)


@router.get(
    "/{upload_id}",
    summary="Get an upload",
    responses=offset_answered() | refuses("upload-not-found"),
    openapi_extra=trying(upload_id="example"),
)
async def get_upload(upload_id: Identifier, store: TheStore, transfers: TheTransfers, response: Response) -> Upload:
    """Return the number of received bytes, and what was made from the upload; `HEAD` returns the same headers alone.

    A part that is still arriving is ended first, and gets 409 `upload-busy`: the next one is accepted at this offset.
    """
    await run_in_threadpool(store.uploads.get, upload_id)  # refused before a part of another key's upload is ended
    await transfers.end(upload_id)
    return _with_headers(response, await run_in_threadpool(store.uploads.get, upload_id))


@router.patch(
    "/{upload_id}",
    needs=Scope.SUBMIT,
    max_body=lambda settings: settings.max_upload_bytes,
    summary="Send a part of an upload",
    responses=offset_answered()
    | with_some(
        refuses_upload(
            *("bad-upload-header", "inconsistent-length", "upload-not-found", "upload-busy", "upload-complete"),
            *("upload-lost", "upload-too-long", "upload-used", "wrong-offset"),
        ),
        409,
        *("Retry-After", "Upload-Offset"),
    ),
    openapi_extra={"parameters": HEADERS}
    | trying_file(BYTES, "/examples/phantom-scan.npz", required=False, upload_id="example"),
)
async def send_part(
    upload_id: Identifier, request: Request, store: TheStore, transfers: TheTransfers, response: Response
) -> Upload:
    """Send the file's bytes from the offset on, all that are missing or fewer, as the body.

    Bytes received before a connection broke are kept, unless the part has a `Content-Digest`: then it counts whole.
    A later `HEAD`, `GET`, `PATCH` or `DELETE` of the upload ends a part that is still arriving.
    """
    announced = announced_part(request.headers)
    content = SentContent(request.headers, packed=False, begins=announced.offset_bytes == 0)
    await run_in_threadpool(store.uploads.get, upload_id)
    async with transfers.begin(upload_id) as transfer:
        part = await run_in_threadpool(_begin, store.uploads, upload_id, announced)
        await _receive(part, announced, transfer.until_ended(request.stream()), content)
    return _with_headers(response, await run_in_threadpool(store.uploads.get, upload_id))


@router.delete(
    "/{upload_id}",
    needs=Scope.SUBMIT,
    status_code=204,
    summary="Delete an upload",
    responses=refuses("upload-not-found"),
    openapi_extra=trying(upload_id="example-spare"),
)
async def delete_upload(upload_id: Identifier, store: TheStore, transfers: TheTransfers, caller: TheCaller) -> None:
    """Delete an upload and its bytes; what was made from it stays. The scope `admin` deletes uploads of other keys."""
    await run_in_threadpool(store.uploads.delete, upload_id, of_all_keys=caller.scope.covers(Scope.ADMIN))
    await transfers.end(upload_id)


async def _receive(
    part: UploadPart, announced: AnnouncedPart, chunks: AsyncIterator[bytes], content: SentContent
) -> None:
    """Write a part in threads; the file is closed in any case, so that the next part can be written."""
    commits = not content.has_digest
    try:
        async for piece in in_parts(chunks):
            await asyncio.to_thread(part.take, content, piece, commits=commits)
        announced.check_end(part.missing_bytes)
        await asyncio.to_thread(part.finish, content)
        await _complete_if_whole(part)
    except (ClientDisconnect, HTTPException, Busy):  # caused by the sender
        if commits:
            await asyncio.to_thread(part.commit)
            await _complete_if_whole(part)
        raise
    finally:
        part.close()


async def _complete_if_whole(part: UploadPart) -> None:
    if not part.missing_bytes:
        await asyncio.get_running_loop().run_in_executor(_SUMS, part.complete)


def _begin(uploads: Uploads, upload_id: str, announced: AnnouncedPart) -> UploadPart:
    try:
        part = uploads.begin_part(upload_id, announced.offset_bytes, part_bytes=announced.part_bytes or 0)
    except WrongOffset as error:
        raise Refused(409, "wrong-offset", str(error), {"Upload-Offset": str(error.expected_bytes)}) from error
    try:
        announced.check(part.upload)
    except Refused:
        part.close()
        raise
    return part


def _with_headers(response: Response, upload: Upload) -> Upload:
    response.headers["Upload-Offset"] = str(upload.offset_bytes)
    response.headers["Upload-Length"] = str(upload.size_bytes)
    response.headers["Upload-Complete"] = "?0" if upload.state is UploadState.RECEIVING else "?1"
    response.headers["Cache-Control"] = "no-store"
    return upload
