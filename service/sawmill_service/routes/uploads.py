"""/v1/uploads: files that come in parts, after the draft "Resumable Uploads for HTTP" of the IETF."""

import asyncio
from concurrent.futures import ThreadPoolExecutor
from typing import Annotated

from fastapi import APIRouter, Header, Request, Response
from fastapi.concurrency import run_in_threadpool
from pydantic import Field
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from sawmill_service.dependencies import TheSettings, TheStore
from sawmill_service.described_answers import offset_answered
from sawmill_service.openapi_document import trying, trying_file
from sawmill_service.problems import Refused
from sawmill_service.refusals import refuses, refuses_upload
from sawmill_service.repeats import repeatable
from sawmill_service.sent_content import BYTES, SentContent
from sawmill_service.settings import ServiceSettings
from sawmill_service.uploads import declared_bytes
from sawmill_worker.contracts.base import Identifier
from sawmill_worker.contracts.uploads import Upload, UploadAsk, UploadState
from sawmill_worker.storage.arriving import in_parts
from sawmill_worker.storage.errors import UploadTooLarge
from sawmill_worker.storage.store import Store
from sawmill_worker.storage.upload_parts import Part
from sawmill_worker.storage.uploads import UploadQuota, WrongOffset

router = APIRouter(prefix="/v1/uploads", tags=["uploads"])
# Summing up a large file takes as long as reading it; the threads that write others do not wait for that.
_SUMS = ThreadPoolExecutor(2, "sums-of-uploads")

Offset = Annotated[
    int,
    Header(description="Where the part begins, in bytes: the offset that `HEAD` gives.", examples=[0]),
    Field(ge=0, le=10**18),
]


@router.post(
    "",
    status_code=201,
    summary="Begin an upload that can be resumed",
    responses=offset_answered(201, "Location") | refuses("upload-too-large", "upload-quota"),
    openapi_extra=trying(body={"size_bytes": 65536, "name": "mill.h5"}),
)
@repeatable
def create_upload(ask: UploadAsk, store: TheStore, settings: TheSettings, response: Response) -> Upload:
    """Declares a file; its bytes follow with `PATCH`. Room for them is kept free; a day after the last part it goes."""
    if ask.size_bytes > settings.max_upload_bytes:
        raise UploadTooLarge(settings.max_upload_bytes)
    store.check_room_for(ask.size_bytes)
    upload = store.uploads.create(ask, _quota(settings))
    response.headers["Location"] = f"/v1/uploads/{upload.id}"
    return _with_headers(response, upload)


@router.get(
    "/{upload_id}",
    summary="Get an upload",
    responses=offset_answered() | refuses("upload-not-found"),
    openapi_extra=trying(upload_id="example"),
)
def get_upload(upload_id: Identifier, store: TheStore, response: Response) -> Upload:
    """What has come of it, and what was made of it; `HEAD` is answered with the same headers alone."""
    return _with_headers(response, store.uploads.get(upload_id))


@router.patch(
    "/{upload_id}",
    summary="Send a part of an upload",
    responses=offset_answered()
    | refuses_upload(
        *("upload-not-found", "upload-busy", "upload-complete", "upload-too-long", "upload-used", "wrong-offset")
    ),
    openapi_extra=trying_file(BYTES, "/examples/phantom-scan.npz", required=False, upload_id="example"),
)
async def send_part(
    upload_id: Identifier, request: Request, store: TheStore, response: Response, upload_offset: Offset = 0
) -> Upload:
    """The body is the file's bytes from the offset on, all that are missing or fewer.

    What came before a connection broke is kept, unless the part has a `Content-Digest`: then it counts as a whole.
    """
    content = SentContent(request.headers, packed=False, begins=upload_offset == 0)
    part = await run_in_threadpool(_begin, store, upload_id, upload_offset, declared_bytes(request))
    await _receive(part, request, content)
    return _with_headers(response, await run_in_threadpool(store.uploads.get, upload_id))


@router.delete(
    "/{upload_id}",
    status_code=204,
    summary="Delete an upload",
    responses=refuses("upload-not-found"),
    openapi_extra=trying(upload_id="example-spare"),
)
def delete_upload(upload_id: Identifier, store: TheStore) -> None:
    """What has come of it too; what was made of it stays."""
    store.uploads.delete(upload_id)


async def _receive(part: Part, request: Request, content: SentContent) -> None:
    """Write a part in threads; however it ends, the file is free for the next one."""
    commits = not content.has_digest
    try:
        async for piece in in_parts(request.stream()):
            await asyncio.to_thread(part.take, content, piece, commits=commits)
        await asyncio.get_running_loop().run_in_executor(_SUMS, part.finish, content)
    except (ClientDisconnect, HTTPException):  # the sender's
        await asyncio.to_thread(part.break_off, commits=commits)
        raise
    except BaseException:
        part.close()
        raise


def _begin(store: Store, upload_id: str, offset_bytes: int, part_bytes: int) -> Part:
    reserve_bytes = store.settings.disk_reserve_bytes
    try:
        return store.uploads.begin_part(upload_id, offset_bytes, part_bytes=part_bytes, reserve_bytes=reserve_bytes)
    except WrongOffset as error:
        raise Refused(409, "wrong-offset", str(error), {"Upload-Offset": str(error.expected_bytes)}) from error


def _quota(settings: ServiceSettings) -> UploadQuota:
    return UploadQuota(
        settings.max_waiting_uploads, settings.max_waiting_upload_bytes, settings.max_all_waiting_upload_bytes
    )


def _with_headers(response: Response, upload: Upload) -> Upload:
    response.headers["Upload-Offset"] = str(upload.offset_bytes)
    response.headers["Upload-Length"] = str(upload.size_bytes)
    response.headers["Upload-Complete"] = "?0" if upload.state is UploadState.RECEIVING else "?1"
    response.headers["Cache-Control"] = "no-store"
    return upload
