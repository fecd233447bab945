"""/v1/reconstructions."""

from enum import IntEnum
from typing import Annotated

from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import Field

from service.answers import Hdf5, Paging, Png, accept, etag, file, picture
from service.dependencies import TheSettings, TheStore, TheWake
from service.openapi_document import trying
from service.problems import Refused
from worker.contracts.base import Contract, Identifier, Page
from worker.contracts.jobs import JobState
from worker.contracts.reconstructions import (
    Reconstruction,
    ReconstructionAsk,
    ReconstructionLinks,
    ReconstructionResult,
)
from worker.pictures.images import image_png, image_png16
from worker.storage import arrays
from worker.storage.store import Store

router = APIRouter(prefix="/v1/reconstructions", tags=["reconstructions"])


class ReconstructionFilter(Paging):
    """Which reconstructions to list."""

    scanner_id: Identifier | None = None
    state: JobState | None = None


class Bits(IntEnum):
    """Depth of a picture's grey."""

    EIGHT = 8
    SIXTEEN = 16


class SliceQuery(Contract):
    """How to draw a slice."""

    bits: Bits = Field(
        Bits.EIGHT, description="8: for people, with scale bar and colour bar. 16: for machines, the values alone."
    )
    window_low: float | None = Field(None, description="Value drawn black, in the volume's unit; null: its low end.")
    window_high: float | None = Field(None, description="Value drawn white, in the volume's unit; null: its high end.")


@router.post("", status_code=202, summary="Ask for a reconstruction", openapi_extra=trying(body={"scan_id": "example"}))
def ask_reconstruction(
    ask: ReconstructionAsk, store: TheStore, settings: TheSettings, wake: TheWake, response: Response
) -> Reconstruction:
    """Slices of a log, with the scanner's active calibration, another one, or a theta of your own.

    The scan may still be read and the calibration still computed: the job waits for them.
    """
    reconstruction = store.reconstructions.accept(ask)
    wake(reconstruction.job_id)
    accept(response, f"/v1/reconstructions/{reconstruction.id}", settings.retry_after_s)
    return _linked(reconstruction)


@router.get("", summary="List reconstructions, newest first")
def list_reconstructions(query: Annotated[ReconstructionFilter, Query()], store: TheStore) -> Page[Reconstruction]:
    """All of them, or those of one scanner, or in one state."""
    page = store.reconstructions.page(
        scanner_id=query.scanner_id, state=query.state, after=query.after, limit=query.limit
    )
    return page.model_copy(update={"items": [_linked(item) for item in page.items]})


@router.get("/{reconstruction_id}", summary="Get a reconstruction")
def get_reconstruction(reconstruction_id: Identifier, store: TheStore) -> Reconstruction:
    """Its state, and its shape and range once it is there."""
    return _linked(store.reconstructions.get(reconstruction_id))


@router.get(
    "/{reconstruction_id}/slices/{index}.png",
    response_class=Png,
    summary="Draw a slice",
    openapi_extra=trying(index=0, bits=8),
)
def get_slice(
    reconstruction_id: Identifier,
    index: Annotated[int, Path(ge=0, description="Slice, from 0.")],
    query: Annotated[SliceQuery, Query()],
    request: Request,
    store: TheStore,
) -> Response:
    """A row of the picture is +x, a column +y."""
    result = _result(store, reconstruction_id)
    if index >= result.shape[0]:
        raise Refused(404, "slice-not-found", f"index must be below {result.shape[0]}, the slices, not {index}")
    window = _window(query, result)

    def draw() -> bytes:
        image = arrays.volume_slice(store.files.volume(reconstruction_id), index)
        if query.bits is Bits.SIXTEEN:
            return image_png16(image.data, window)
        return image_png(image.data, pixel_mm=image.pixel_mm, unit=image.unit, window=window, title=None)

    return picture(request, etag(reconstruction_id, index, query.bits, window), draw)


@router.head("/{reconstruction_id}/volume.h5", include_in_schema=False)
@router.get(
    "/{reconstruction_id}/volume.h5",
    response_class=Hdf5,
    summary="Get the volume as HDF5",
    responses={206: {"description": "The range asked for."}},
)
def get_volume(reconstruction_id: Identifier, request: Request, store: TheStore) -> Response:
    """`/entry/reconstruction/data`, float32 (slice, x, y). `Range` requests are answered."""
    _result(store, reconstruction_id)
    path = store.files.volume(reconstruction_id)
    return file(request, path, Hdf5.media_type, save_as=f"reconstruction-{reconstruction_id}.h5")


def _linked(reconstruction: Reconstruction) -> Reconstruction:
    path = f"/v1/reconstructions/{reconstruction.id}"
    links = ReconstructionLinks(
        self=path,
        job=f"/v1/jobs/{reconstruction.job_id}",
        volume=f"{path}/volume.h5",
        first_slice=f"{path}/slices/0.png",
    )
    return reconstruction.model_copy(update={"links": links})


def _result(store: Store, reconstruction_id: str) -> ReconstructionResult:
    reconstruction = store.reconstructions.get(reconstruction_id)
    if reconstruction.result is None:
        detail = f"reconstruction {reconstruction_id!r} is {reconstruction.state} and has no volume"
        raise Refused(409, "reconstruction-without-result", detail)
    return reconstruction.result


def _window(query: SliceQuery, result: ReconstructionResult) -> tuple[float, float]:
    low = result.value_range[0] if query.window_low is None else query.window_low
    high = result.value_range[1] if query.window_high is None else query.window_high
    if not low < high:
        raise Refused(422, "empty-window", f"window_low must be below window_high, not {low} and {high}")
    return low, high
