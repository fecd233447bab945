"""/v1/calibrations."""

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from sawmill_service.answers import Hdf5, Paging, Png, accept, file
from sawmill_service.dependencies import TheSettings, TheStore, TheWake
from sawmill_service.drawing import CalibrationPicture, calibration_picture
from sawmill_service.openapi_document import trying
from sawmill_service.problems import Refused
from sawmill_worker.contracts.base import Contract, Identifier, Name, Page
from sawmill_worker.contracts.calibrations import (
    Calibration,
    CalibrationAsk,
    CalibrationLinks,
    CalibrationSucceeded,
    CalibrationUnfinished,
)
from sawmill_worker.contracts.jobs import JobKind, JobState
from sawmill_worker.contracts.scanners import Scanner
from sawmill_worker.storage.store import Store

router = APIRouter(prefix="/v1/calibrations", tags=["calibrations"])


class CalibrationFilter(Paging):
    """Which calibrations to list."""

    scanner_id: Identifier | None = None
    state: JobState | None = None


class Activate(Contract):
    """Why a calibration becomes the active one."""

    reason: Name = "activated by hand"


BY_HAND = Activate()


@router.post(
    "",
    status_code=202,
    response_model=Calibration,
    summary="Ask for a calibration",
    openapi_extra=trying(body={"scan_id": "example"}),
)
def ask_calibration(
    ask: CalibrationAsk, store: TheStore, settings: TheSettings, wake: TheWake, response: Response
) -> CalibrationUnfinished | CalibrationSucceeded:
    """Find theta from a scan of a phantom.

    The scan may still be read: the job waits for it. `GET` the calibration, or stream its job's events, until it ends.
    """
    calibration = store.calibrations.accept(ask)
    wake(calibration.job_id)
    accept(response, f"/v1/calibrations/{calibration.id}", settings.retry_after_s)
    return linked(calibration)


@router.get("", response_model=Page[Calibration], summary="List calibrations, newest first")
def list_calibrations(
    query: Annotated[CalibrationFilter, Query()], store: TheStore
) -> Page[CalibrationUnfinished | CalibrationSucceeded]:
    """All of them, or those of one scanner, or in one state."""
    page = store.calibrations.page(scanner_id=query.scanner_id, state=query.state, after=query.after, limit=query.limit)
    return page.model_copy(update={"items": [linked(item) for item in page.items]})


@router.get("/{calibration_id}", response_model=Calibration, summary="Get a calibration")
def get_calibration(calibration_id: Identifier, store: TheStore) -> CalibrationUnfinished | CalibrationSucceeded:
    """Its state, and the whole answer once there is one."""
    return linked(store.calibrations.get(calibration_id))


@router.head("/{calibration_id}/report.png", include_in_schema=False)
@router.get("/{calibration_id}/report.png", response_class=Png, summary="Get the report picture")
def get_report(calibration_id: Identifier, request: Request, store: TheStore) -> Response:
    """The verdict and the numbers, the phantom found, a log before and after, and how it is known, on one page.

    Drawn on the first request, which takes seconds, and kept.
    """
    return _picture(request, store, calibration_id, CalibrationPicture.REPORT)


@router.head("/{calibration_id}/overlay.png", include_in_schema=False)
@router.get("/{calibration_id}/overlay.png", response_class=Png, summary="Get the phantom with its outline")
def get_overlay(calibration_id: Identifier, request: Request, store: TheStore) -> Response:
    """The phantom reconstructed with the theta found, and its drawing over it; drawn on the first request and kept."""
    return _picture(request, store, calibration_id, CalibrationPicture.OVERLAY)


@router.head("/{calibration_id}/result.h5", include_in_schema=False)
@router.get("/{calibration_id}/result.h5", response_class=Hdf5, summary="Get the calibration as HDF5")
def get_calibration_file(calibration_id: Identifier, request: Request, store: TheStore) -> Response:
    """Every number, with the sinogram, the model's and the residual."""
    _check_succeeded(store, calibration_id, "result.h5")
    path = store.files.result(JobKind.CALIBRATE, calibration_id, "result.h5")
    return file(request, path, Hdf5.media_type, save_as=f"calibration-{calibration_id}.h5")


@router.post(
    "/{calibration_id}/activate",
    summary="Make a calibration the active one",
    openapi_extra=trying(body={"reason": "checked by hand"}),
)
def activate_calibration(calibration_id: Identifier, store: TheStore, activate: Activate = BY_HAND) -> Scanner:
    """Reconstructions use it from now on. An older one rolls back. Refused (409) without an answer."""
    return store.calibrations.activate(calibration_id, activate.reason)


def linked(
    calibration: CalibrationUnfinished | CalibrationSucceeded,
) -> CalibrationUnfinished | CalibrationSucceeded:
    """Say where a calibration's files are."""
    path = f"/v1/calibrations/{calibration.id}"
    links = CalibrationLinks(
        self=path,
        job=f"/v1/jobs/{calibration.job_id}",
        report=f"{path}/report.png",
        overlay=f"{path}/overlay.png",
        hdf5=f"{path}/result.h5",
    )
    return calibration.model_copy(update={"links": links})


def _picture(request: Request, store: Store, calibration_id: str, picture: CalibrationPicture) -> Response:
    _check_succeeded(store, calibration_id, picture)
    return file(request, calibration_picture(store, calibration_id, picture), Png.media_type)


def _check_succeeded(store: Store, calibration_id: str, name: str) -> None:
    calibration = store.calibrations.get(calibration_id)
    if not isinstance(calibration, CalibrationSucceeded):
        detail = f"calibration {calibration_id!r} is {calibration.state} and has no {name}"
        raise Refused(409, "calibration-without-result", detail)
