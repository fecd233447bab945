"""/v1/phantoms."""

from typing import Annotated

from fastapi import Query, Request, Response
from fastapi.concurrency import run_in_threadpool

from sawmill_calibration.pictures.phantom_drawing import phantom_svg
from sawmill_contracts.phantoms import MeasurementsRequest, PhantomPicture, PhantomRequest, StoredPhantom
from sawmill_platform.contracts.base import Identifier, Page
from sawmill_platform.contracts.given import Given
from sawmill_platform.contracts.jobs import Priority
from sawmill_platform.contracts.keys import Scope
from sawmill_service.dependencies import TheSettings, TheStore, TheWake
from sawmill_service.http.bodies.sent_json import Sent
from sawmill_service.http.document import described_answers
from sawmill_service.http.document.openapi_document import trying, trying_file
from sawmill_service.http.problems import Refused
from sawmill_service.http.repeats import TheRepeatableWithFile, repeatable
from sawmill_service.http.responses.answers import Paging, RequestPriority, Svg, accept
from sawmill_service.http.responses.drawn import picture
from sawmill_service.http.responses.waiting import TheWaiting
from sawmill_service.http.route_rules import Router
from sawmill_service.uploads import TheReception, UploadId

router = Router(prefix="/v1/phantoms", tags=["phantoms"], reading=Scope.READ)
PICTURES = "/pictures"

EXAMPLE = {
    "name": "board with a hole",
    "shapes": [
        {"kind": "polygon", "vertices_mm": [[-100, -150], [100, -150], [100, 150], [-100, 150]]},
        {"kind": "disc", "center_mm": [-50, -50], "radius_mm": 26, "density": -1},
    ],
}

MEASURED = {
    "measurements": [
        {
            "dimension": "x",
            "measured_mm": 200.1,
            "standard_uncertainty_mm": 0.05,
            "measured_on": "2026-11-02",
            "instrument": "caliper 12",
            "moisture_percent": 11,
            "expires_on": "2027-11-02",
        }
    ]
}


class PictureUpload(Given, PhantomPicture):
    """Query of the upload of a picture: the phantom's description, and the priority of tracing."""

    priority: RequestPriority = Priority.INTERACTIVE
    upload_id: UploadId = None

    @property
    def picture(self) -> PhantomPicture:
        """Description that is stored."""
        return PhantomPicture.model_validate(self.model_dump(exclude={"priority", "upload_id"}, exclude_unset=True))


@router.post(
    "",
    needs=Scope.SUBMIT,
    status_code=201,
    summary="Draw a phantom",
    openapi_extra=trying(body=EXAMPLE),
    responses=described_answers.LOCATED,
)
@repeatable
def create_phantom(drawing: Sent[PhantomRequest], store: TheStore, response: Response) -> StoredPhantom:
    """Draw a phantom from polygons and discs in mm, the rotation centre at the origin. Ready at once."""
    phantom = store.phantoms.create(drawing)
    response.headers["Location"] = f"/v1/phantoms/{phantom.id}"
    return phantom


@router.post(
    PICTURES,
    needs=Scope.SUBMIT,
    max_body=lambda settings: settings.max_picture_bytes,
    status_code=202,
    summary="Upload a phantom's picture",
    openapi_extra=trying_file("image/png", "/static/phantom.png"),
    responses=described_answers.refuses_upload(*described_answers.OF_UPLOAD_ID, *described_answers.OF_QUEUE),
)
async def upload_phantom_picture(
    upload: Annotated[PictureUpload, Query()],
    *,
    response: Response,
    reception: TheReception,
    store: TheStore,
    settings: TheSettings,
    wake: TheWake,
    repeatable: TheRepeatableWithFile,
) -> StoredPhantom:
    """Send a PNG as the body; a job traces its outlines.

    Bright pixels are wood. A row of the picture is +x, a column +y; the picture's centre is the rotation centre.
    [A picture to try](/static/phantom.png) (400 mm wide).
    """
    async with repeatable.unless_repeated():
        await run_in_threadpool(store.places.check)
        received = await reception.file(None, upload.upload_id, max_bytes=settings.max_picture_bytes)

    def accepted() -> StoredPhantom:
        phantom = store.phantoms.accept_picture(upload.picture, received, priority=upload.priority)
        if phantom.job_id is not None:
            wake(phantom.job_id)
        accept(response, f"/v1/phantoms/{phantom.id}", settings.retry_after_s)
        return phantom

    return await run_in_threadpool(repeatable.once_with, received, accepted, in_body=upload.upload_id is None)


@router.get("", summary="List phantoms, newest first", responses=described_answers.refuses("invalid-cursor"))
def list_phantoms(paging: Annotated[Paging, Query()], store: TheStore) -> Page[StoredPhantom]:
    """List phantoms; the built-in ones are `l-shape` and `rectangle-with-hole`."""
    return store.phantoms.page(after=paging.after, limit=paging.limit)


@router.get(
    "/{phantom_id}",
    summary="Get a phantom",
    openapi_extra=trying(phantom_id="l-shape"),
    responses=described_answers.refuses("phantom-not-found"),
)
async def get_phantom(phantom_id: Identifier, store: TheStore, waiting: TheWaiting) -> StoredPhantom:
    """Return the phantom's outlines in mm; null while its picture is being traced. `wait` waits for the tracing."""
    return await waiting.read(lambda: store.phantoms.get(phantom_id))


@router.get(
    "/{phantom_id}/drawing.svg",
    response_class=Svg,
    summary="Draw a phantom to print at full size",
    openapi_extra=trying(phantom_id="l-shape"),
    responses=described_answers.drawn("phantom-not-found", "phantom-without-drawing"),
)
def get_drawing(phantom_id: Identifier, request: Request, store: TheStore) -> Response:
    """Draw an SVG in mm: outlines, holes, size, rotation centre and a scale bar. Down is +x, right is +y."""
    phantom = store.phantoms.get(phantom_id)
    drawing = phantom.drawing
    if drawing is None:
        raise Refused(409, "phantom-without-drawing", f"phantom {phantom_id!r} is {phantom.state} and has no drawing")
    return picture(request, drawing.model_dump_json(), lambda: phantom_svg(drawing), answer=Svg)


@router.post(
    "/{phantom_id}/measurements",
    needs=Scope.SUBMIT,
    status_code=201,
    summary="Measure a phantom again",
    openapi_extra=trying(phantom_id="l-shape", body=MEASURED),
    responses=described_answers.LOCATED
    | described_answers.refuses("phantom-not-found", "phantom-without-drawing", "measurement-of-another-phantom"),
)
@repeatable
def measure_phantom(
    phantom_id: Identifier, measured: Sent[MeasurementsRequest], store: TheStore, response: Response
) -> StoredPhantom:
    """Make a phantom of the newly measured size, which `follows` this one; this one stays for what refers to it.

    A length replaces an earlier one of the same name; other lengths stay.
    """
    phantom = store.phantoms.measure(phantom_id, measured)
    response.headers["Location"] = f"/v1/phantoms/{phantom.id}"
    return phantom


@router.delete(
    "/{phantom_id}",
    needs=Scope.ADMIN,
    status_code=204,
    summary="Delete an unused phantom",
    openapi_extra=trying(phantom_id="example-spare"),
    responses=described_answers.refuses("phantom-not-found", "phantom-built-in", "phantom-in-use"),
)
def delete_phantom(phantom_id: Identifier, store: TheStore) -> None:
    """Delete a phantom. Refused (409) for a built-in one, and while scans or calibrations refer to it."""
    store.phantoms.delete(phantom_id)
