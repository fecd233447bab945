"""/v1/scans."""

from typing import Annotated

from fastapi import Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from pydantic import Field

from sawmill_contracts.scans import Scan, ScanShape, ScanSpec, ScanState
from sawmill_platform.contracts.base import LARGEST_NUMBER, Identifier, Page
from sawmill_platform.contracts.given import Given
from sawmill_platform.contracts.keys import Scope
from sawmill_service.dependencies import TheSettings, TheStore, TheWake
from sawmill_service.drawing import BYTES_PER_VALUE, ready_scan, scan_thumbnail
from sawmill_service.http.document.described_answers import (
    OF_QUEUE,
    OF_SCAN,
    OF_UPLOAD_ID,
    drawn,
    refuses,
    refuses_upload,
    stored,
)
from sawmill_service.http.document.openapi_document import trying, trying_file
from sawmill_service.http.repeats import TheRepeatableWithFile
from sawmill_service.http.responses.answers import Dated, Png, accept
from sawmill_service.http.responses.drawn import kept_picture, picture
from sawmill_service.http.responses.waiting import TheWaiting
from sawmill_service.http.route_rules import Router
from sawmill_service.uploads import FileQuery, TheReception
from sawmill_store.mill_files import MillFiles

router = Router(prefix="/v1/scans", tags=["scans"], reading=Scope.READ)


class ScanFilter(Dated):
    """Filter of the scans to list."""

    scanner_id: Identifier | None = Field(None, description="Id of the scanner. Default: any.")
    state: ScanState | None = None


class ScanUpload(FileQuery, ScanSpec):
    """Description of a scan that is sent with its file or the id of an earlier one, and the priority of reading."""

    @property
    def spec(self) -> ScanSpec:
        """Description that is stored."""
        return ScanSpec.model_validate(self.model_dump(include=set(ScanSpec.model_fields), exclude_unset=True))


class SinogramQuery(Given):
    """Row of the sinogram to draw."""

    row: Annotated[int, Field(ge=0, le=LARGEST_NUMBER)] = Field(0, description="Number of the detector row, from 0.")


@router.post(
    "",
    needs=Scope.SUBMIT,
    max_body=lambda settings: settings.max_upload_bytes,
    status_code=202,
    summary="Upload a scan",
    openapi_extra=trying_file(
        "application/octet-stream",
        "/examples/phantom-scan.npz",
        required=False,
        scanner_id="example",
        data="counts",
        name="a first scan",
        phantom_id="l-shape",
    ),
    responses=refuses_upload(
        *("scanner-not-found", "phantom-not-found", "phantom-refused"),
        *("inspection-not-found", "inspection-expired"),
        *OF_UPLOAD_ID,
        *OF_QUEUE,
    ),
)
async def upload_scan(
    upload: Annotated[ScanUpload, Query()],
    *,
    response: Response,
    reception: TheReception,
    store: TheStore,
    settings: TheSettings,
    wake: TheWake,
    repeatable: TheRepeatableWithFile,
) -> Scan:
    """Send the file's bytes as the body, or name an inspection of the file; a job reads it.

    HDF5 (NXtomo, Data Exchange), TIFF or a ZIP of TIFFs, NPY, NPZ and MAT are recognised by their content.
    A drift check needs only the mean of a log's rows: line integrals (views, detector), with `averaged_rows`.
    `GET` the scan until its state is `ready`, or `refused` with the reason.
    [A file to try](/examples/phantom-scan.npz): counts with flat and dark fields and angles.
    """
    async with repeatable.unless_repeated():
        await run_in_threadpool(store.scans.check, upload.spec)
        received = await reception.file(upload.inspection_id, upload.upload_id, max_bytes=settings.max_upload_bytes)

    def accepted() -> Scan:
        scan = store.scans.accept(upload.spec, received, priority=upload.priority)
        wake(scan.job_id)
        accept(response, f"/v1/scans/{scan.id}", settings.retry_after_s)
        return scan

    return await run_in_threadpool(repeatable.once_with, received, accepted, in_body=upload.sends_file)


@router.get("", summary="List scans, newest first", responses=refuses("invalid-cursor"))
def list_scans(query: Annotated[ScanFilter, Query()], store: TheStore) -> Page[Scan]:
    """List all scans, or a selection by scanner, state or span of time."""
    return store.scans.page(**query.model_dump())


@router.get("/{scan_id}", summary="Get a scan", responses=refuses("scan-not-found"))
async def get_scan(scan_id: Identifier, store: TheStore, waiting: TheWaiting) -> Scan:
    """Return the scan's state and the file's format; with `wait` when the file has been read."""
    return await waiting.read(lambda: store.scans.get(scan_id))


@router.delete(
    "/{scan_id}",
    needs=Scope.ADMIN,
    status_code=204,
    summary="Delete a scan",
    openapi_extra=trying(scan_id="example-spare"),
    responses=refuses("scan-not-found", "scan-in-use"),
)
def delete_scan(scan_id: Identifier, store: TheStore) -> None:
    """Delete a scan and its files; results made from it stay. Refused (409) while a job needs it."""
    store.scans.delete(scan_id)


@router.get("/{scan_id}/preview", response_class=Png, summary="Preview a scan", responses=drawn(*OF_SCAN))
def preview_scan(scan_id: Identifier, request: Request, store: TheStore) -> Response:
    """Draw the middle row's sinogram."""
    scan, shape = ready_scan(store.scans, scan_id)
    return _sinogram(request, store.scans.files, scan, shape, shape.rows // 2)


@router.get(
    "/{scan_id}/sinogram.png",
    response_class=Png,
    summary="Draw one row's sinogram",
    openapi_extra=trying(row=0),
    responses=drawn(*OF_SCAN, "row-out-of-range"),
)
def get_sinogram(
    scan_id: Identifier, query: Annotated[SinogramQuery, Query()], request: Request, store: TheStore
) -> Response:
    """Draw line integrals over views and detector cells."""
    scan, shape = ready_scan(store.scans, scan_id)
    return _sinogram(request, store.scans.files, scan, shape, query.row)


@router.get(
    "/{scan_id}/thumbnail.png", response_class=Png, summary="Get a scan as a small picture", responses=stored(*OF_SCAN)
)
def get_scan_thumbnail(scan_id: Identifier, request: Request, store: TheStore) -> Response:
    """Draw the middle row's sinogram as a square of 160 pixels, for lists."""
    scan, shape = ready_scan(store.scans, scan_id)
    return kept_picture(request, _row_bytes(shape), lambda: scan_thumbnail(store.scans.files, scan, shape))


def _sinogram(request: Request, files: MillFiles, scan: Scan, shape: ScanShape, row: int) -> Response:
    def draw() -> bytes:
        # The first picture imports this: a service that draws none does not hold NumPy, h5py and Pillow.
        from sawmill_calibration.pictures.images import sinogram_png  # noqa: PLC0415
        from sawmill_formats.output import scan_reader  # noqa: PLC0415

        sinogram = scan_reader.sinogram(files.scan(scan.id), shape.lengths, row)
        return sinogram_png(
            sinogram.data, angles_deg=sinogram.angles_deg, pitch_mm=sinogram.pitch_mm, unit="line integral"
        )

    return picture(request, (scan.id, scan.sha256, row), draw, size_bytes=_row_bytes(shape))


def _row_bytes(shape: ScanShape) -> int:
    """Return the peak of the memory in which a sinogram is drawn."""
    return BYTES_PER_VALUE * shape.views * shape.detector
