"""/v1/scans/form."""

from functools import partial
from typing import Annotated, Any

from fastapi import Request, Response
from fastapi.concurrency import run_in_threadpool
from pydantic import ConfigDict, Field, WithJsonSchema, model_validator

from sawmill_contracts.scans import Scan, state_what_is_averaged
from sawmill_platform.contracts.base import Name
from sawmill_platform.contracts.keys import Scope
from sawmill_service.dependencies import ThePlaces, TheScans, TheSettings, TheWake
from sawmill_service.http.bodies.sent_form import FILE, SentForm
from sawmill_service.http.document.described_answers import BINARY
from sawmill_service.http.document.openapi_document import trying_form
from sawmill_service.http.document.refusals import OF_QUEUE, refuses_upload
from sawmill_service.http.repeats import TheRepeatableWithFile
from sawmill_service.http.route_rules import Router
from sawmill_service.routes.scans import GivenScan
from sawmill_service.uploads import TheReception

router = Router(prefix="/v1/scans", tags=["scans"])


def _change(schema: dict[str, Any]) -> None:
    """Add the rules between fields; remove the default name, which clients would send instead of the file's name."""
    state_what_is_averaged(schema)
    del schema["properties"]["name"]["default"]


class ScanForm(GivenScan):
    """A scan's file, its description, and how urgent its reading is."""

    model_config = ConfigDict(json_schema_extra=_change)

    name: Name = Field(
        "scan",
        description="Name for people. Default: the file's name.",
        examples=["phantom of week 10"],
    )
    file: Annotated[str, WithJsonSchema(BINARY)] = Field(
        description="Bytes of the file; its name is the part's `filename`.", examples=["mill.h5"]
    )

    @model_validator(mode="before")
    @classmethod
    def _is_called_as_its_file(cls, fields: dict[str, str]) -> dict[str, str]:
        return {"name": fields[FILE], **fields} if fields.get(FILE) else fields


@router.post(
    "/form",
    needs=Scope.SUBMIT,
    max_body=lambda settings: settings.max_form_file_bytes + settings.max_json_bytes,
    status_code=202,
    summary="Upload a scan as a form",
    openapi_extra=trying_form(
        ScanForm, "/examples/phantom-scan.npz", scanner_id="example", data="counts", phantom_id="l-shape"
    ),
    responses=refuses_upload(
        *("bad-form", "two-files", "scanner-not-found", "phantom-not-found", "phantom-refused"),
        *OF_QUEUE,
    ),
)
async def upload_scan_form(
    *,
    request: Request,
    response: Response,
    reception: TheReception,
    places: ThePlaces,
    scans: TheScans,
    settings: TheSettings,
    wake: TheWake,
    repeatable: TheRepeatableWithFile,
) -> Scan:
    """Upload a scan like `POST /v1/scans`, with file and description as parts of a form, for consoles and `curl -F`.

    The file is the field `file`, of 64 MiB at most (`SAWMILL_MAX_FORM_BYTES`). If all other fields precede the
    file, scanner and phantom are looked up before it is received; a wrong value before it is refused at once.
    """
    content = SentForm(request.headers, ScanForm, max_field_bytes=settings.max_json_bytes)
    async with repeatable.unless_repeated(content):
        await run_in_threadpool(places.check)
        content.check = lambda form: scans.check(form.spec)
        received = await reception.body(max_bytes=settings.max_form_file_bytes, form=content)

    make = partial(content.form.accept, received, response, scans, settings, wake)
    sent_sha256 = content.sha256_with(received.sha256)
    return await run_in_threadpool(repeatable.once_with, received, make, sent_sha256=sent_sha256)
