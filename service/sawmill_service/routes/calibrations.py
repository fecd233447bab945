"""/v1/calibrations: pictures, the file and activation, in addition to the routes of every asked kind."""

from typing import Annotated

from fastapi import Query, Request, Response
from pydantic import Field

from sawmill_contracts import kinds
from sawmill_contracts.calibrations import CalibrationSucceeded
from sawmill_contracts.next_steps import NextStepAnswer
from sawmill_contracts.scanners import StoredScanner
from sawmill_platform.contracts.base import Identifier, Name
from sawmill_platform.contracts.given import Given
from sawmill_platform.contracts.keys import Scope
from sawmill_service.dependencies import TheStore
from sawmill_service.drawing import FIGURE_BYTES, CalibrationPicture, calibration_picture, report_picture
from sawmill_service.http.bodies.sent_json import Sent
from sawmill_service.http.document.described_answers import refuses, stored
from sawmill_service.http.document.openapi_document import trying
from sawmill_service.http.problems import Refused
from sawmill_service.http.repeats import repeatable
from sawmill_service.http.responses.answers import Hdf5, Png, file
from sawmill_service.http.responses.drawn import kept_picture
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.frame.languages import Language
from sawmill_service.pages.frame.page_frame import formats_of
from sawmill_service.scanner_conditions import step_with
from sawmill_store.calibrations import Calibrations

router = Router(prefix="/v1/calibrations", tags=["calibrations"], reading=Scope.READ)


class ActivationRequest(Given):
    """Reason for an activation."""

    reason: Name = Field(
        "activated by hand",
        description="Reason, for the scanner's history and the audit.",
        examples=["checked by hand"],
    )


BY_HAND = ActivationRequest()


class DiscardRequest(Given):
    """Reason for putting a calibration aside."""

    reason: Name = Field(description="Reason, for the scanner's history and the audit.", examples=["wrong file"])


class InLanguage(Given):
    """Language of a report."""

    language: Language = Field(Language.ENGLISH, description="Language of the sentences: en or fi.", examples=["fi"])


@router.get(
    "/{calibration_id}/next-step",
    summary="Get the next step with a calibration",
    responses=refuses("calibration-not-found", "calibration-without-result"),
)
def get_calibration_step(calibration_id: Identifier, store: TheStore) -> NextStepAnswer:
    """Return what a person does next with the calibration, by its verdict and by the state of its scanner now."""
    return step_with(store, succeeded(store.calibrations, calibration_id, "next step")).answer


@router.get(
    "/{calibration_id}/report.png",
    response_class=Png,
    summary="Get the report picture",
    responses=stored("calibration-not-found", "calibration-without-result"),
)
def get_report(
    calibration_id: Identifier, request: Request, store: TheStore, asked: Annotated[InLanguage, Query()]
) -> Response:
    """Draw the verdict and the numbers, the phantom's image, a log before and after, and the evidence, on one page.

    The report is drawn on the first request of a language and of a next step, which takes seconds, and stored.
    """
    calibration = succeeded(store.calibrations, calibration_id, "report.png")
    step, reader = step_with(store, calibration), formats_of(asked.language).reader
    return kept_picture(request, FIGURE_BYTES, lambda: report_picture(store.files, calibration_id, step, reader))


@router.get(
    "/{calibration_id}/overlay.png",
    response_class=Png,
    summary="Get the phantom with its outline",
    responses=stored("calibration-not-found", "calibration-without-result"),
)
def get_overlay(calibration_id: Identifier, request: Request, store: TheStore) -> Response:
    """Draw the phantom reconstructed with the calibrated theta, and its outline; drawn once and stored."""
    return _picture(request, store.calibrations, calibration_id, CalibrationPicture.OVERLAY)


@router.get(
    "/{calibration_id}/log-before.png",
    response_class=Png,
    summary="Get the log before the calibration",
    responses=stored("calibration-not-found", "calibration-without-result", "no-log"),
)
def get_log_before(calibration_id: Identifier, request: Request, store: TheStore) -> Response:
    """Draw a log of the same scan with the calibration that was active then; without one, neither shifted nor tilted.

    The picture has the grey window and the size of `log-after.png`. 404 where the scan shows no log beside the phantom.
    """
    return _picture(request, store.calibrations, calibration_id, CalibrationPicture.LOG_BEFORE)


@router.get(
    "/{calibration_id}/log-after.png",
    response_class=Png,
    summary="Get the log with the calibration",
    responses=stored("calibration-not-found", "calibration-without-result", "no-log"),
)
def get_log_after(calibration_id: Identifier, request: Request, store: TheStore) -> Response:
    """Draw a log of the same scan with this calibration. 404 where the scan shows no log beside the phantom."""
    return _picture(request, store.calibrations, calibration_id, CalibrationPicture.LOG_AFTER)


@router.get(
    "/{calibration_id}/result.h5",
    response_class=Hdf5,
    summary="Get the calibration as HDF5",
    responses=stored("calibration-not-found", "calibration-without-result", "result-h5-not-found"),
)
def get_calibration_file(calibration_id: Identifier, request: Request, store: TheStore) -> Response:
    """Return every number, with the sinogram, its model and the residual."""
    succeeded(store.calibrations, calibration_id, "result.h5")
    files = store.calibrations.files
    path = files.unverified(kinds.CALIBRATE, calibration_id, "result.h5")
    name = f"calibration-{calibration_id}.h5"
    return file(request, path, "application/x-hdf5", save_as=name, digest=files.verified.digest)


@router.post(
    "/{calibration_id}/activate",
    needs=Scope.ACTIVATE,
    summary="Make a calibration the active one",
    openapi_extra=trying(body={"reason": "checked by hand"}),
    responses=refuses("calibration-not-found", "calibration-without-result"),
)
@repeatable
def activate_calibration(
    calibration_id: Identifier, store: TheStore, activate: Sent[ActivationRequest] = BY_HAND
) -> StoredScanner:
    """Use the calibration from now on; an older one is a roll-back. Refused (409) where it has no answer."""
    return store.calibrations.activate(calibration_id, activate.reason)


@router.post(
    "/{calibration_id}/discard",
    needs=Scope.ACTIVATE,
    summary="Discard a failed or unaccepted calibration",
    openapi_extra=trying(calibration_id="example-spare", body={"reason": "wrong file"}),
    responses=refuses("calibration-not-found", "calibration-unfinished", "calibration-in-use"),
)
@repeatable
def discard_calibration(calibration_id: Identifier, store: TheStore, discard: Sent[DiscardRequest]) -> StoredScanner:
    """Put it aside: its scanner is shown without it, and it stays stored. Refused (409) while it runs or is in use."""
    return store.calibrations.discard(calibration_id, discard.reason)


def _picture(
    request: Request, calibrations: Calibrations, calibration_id: str, picture: CalibrationPicture
) -> Response:
    succeeded(calibrations, calibration_id, picture)
    return kept_picture(request, FIGURE_BYTES, lambda: calibration_picture(calibrations.files, calibration_id, picture))


def succeeded(calibrations: Calibrations, calibration_id: str, name: str) -> CalibrationSucceeded:
    """Return a calibration that has succeeded; `name` is the requested file, for the refusal.

    Raises
    ------
    Refused
        409 `calibration-without-result`.
    """
    calibration = calibrations.get(calibration_id)
    if isinstance(calibration, CalibrationSucceeded):
        return calibration
    raise Refused(
        409, "calibration-without-result", f"calibration {calibration_id!r} is {calibration.state} and has no {name}"
    )
