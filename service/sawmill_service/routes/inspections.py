"""/v1/inspections: routes of the kind whose ask is a file."""

from typing import Annotated

from fastapi import Query, Response
from fastapi.concurrency import run_in_threadpool
from pydantic import Field

from sawmill_contracts.inspections import DECLARATION, Inspection, InspectionOptions
from sawmill_platform.contracts.base import Identifier, Name
from sawmill_platform.contracts.keys import Scope
from sawmill_service.dependencies import TheSettings, TheStore, TheWake
from sawmill_service.http.document.described_answers import OF_QUEUE, OF_UPLOAD_ID, refuses, refuses_upload
from sawmill_service.http.document.openapi_document import trying, trying_file
from sawmill_service.http.repeats import TheRepeatableWithFile
from sawmill_service.http.responses.answers import accept
from sawmill_service.http.route_rules import Router
from sawmill_service.routes.asked import linked
from sawmill_service.uploads import FileQuery, TheReception

router = Router(prefix="/v1/inspections", tags=["inspections"])


class InspectionUpload(FileQuery, InspectionOptions):
    """Query of the upload of a file."""

    name: Name = Field("file", description="Name of the file for people.", examples=["mill.h5"])

    @property
    def options(self) -> InspectionOptions:
        """Options of the inspection."""
        return InspectionOptions(**self.model_dump(include=set(InspectionOptions.model_fields)))


@router.post(
    "",
    needs=Scope.SUBMIT,
    max_body=lambda settings: settings.max_upload_bytes,
    status_code=202,
    name="inspect_file",
    summary=DECLARATION.to_ask.summary,
    description=DECLARATION.to_ask.description,
    openapi_extra=trying_file("application/octet-stream", "/examples/phantom-scan.npz", required=False),
    responses=refuses_upload("inspection-not-found", "inspection-expired", *OF_UPLOAD_ID, *OF_QUEUE),
)
async def inspect_file(
    upload: Annotated[InspectionUpload, Query()],
    *,
    response: Response,
    reception: TheReception,
    store: TheStore,
    settings: TheSettings,
    wake: TheWake,
    repeatable: TheRepeatableWithFile,
) -> Inspection:
    """Inspect a file; the declaration has the public description."""
    async with repeatable.unless_repeated():
        if upload.sends_file:
            await run_in_threadpool(store.places.check)
        received = await reception.file(upload.inspection_id, upload.upload_id, max_bytes=settings.max_upload_bytes)

    def accepted() -> Inspection:
        inspection = store.inspections.accept_file(upload.options, received, name=upload.name, priority=upload.priority)
        wake(inspection.job_id)
        accept(response, f"/v1/inspections/{inspection.id}", settings.retry_after_s)
        return linked(DECLARATION, inspection)  # type: ignore[no-any-return]

    return await run_in_threadpool(repeatable.once_with, received, accepted, in_body=upload.sends_file)


@router.delete(
    "/{inspection_id}",
    needs=Scope.ADMIN,
    status_code=204,
    summary="Delete an inspection",
    openapi_extra=trying(inspection_id="example-spare"),
    responses=refuses("inspection-not-found", "inspection-in-use"),
)
def delete_inspection(inspection_id: Identifier, store: TheStore) -> None:
    """Delete an inspection and its file; a scan made from the file stays. Refused (409) while its job has not ended."""
    store.inspections.delete(inspection_id)
