"""Pages of logs: the reconstructions, and the viewer of their slices."""

from collections.abc import Iterable, Mapping
from functools import partial
from typing import Annotated, Any
from urllib.parse import quote

from fastapi import Query, Response
from fastapi.responses import RedirectResponse
from pydantic import ValidationError

from sawmill_contracts.calibrations import Calibration, CalibrationSucceeded
from sawmill_contracts.reconstructions import Reconstruction, ReconstructionName
from sawmill_platform.contracts.base import Identifier, placed_complaint
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.errors import NotFound, if_found
from sawmill_service.dependencies import TheSettings, TheStore
from sawmill_service.http.bodies.forms import TheForm
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.frame.languages import COLOR_MAPS, LOG_STATES
from sawmill_service.pages.frame.page_frame import PageFrame, ThePage
from sawmill_service.pages.job_words import stages
from sawmill_service.pages.lists import TheFilter
from sawmill_store.calibrations import Reconstructions
from sawmill_store.mill_files import MillFiles
from sawmill_store.store import Store
from sawmill_vocabulary import ReconstructionMethod

# Number of logs for comparison from the same scan, and from the same scanner.
_OTHERS = 25

router = Router(include_in_schema=False, reading=Scope.READ)


@router.get("/logs")
def logs(page: ThePage, store: TheStore, settings: TheSettings, chosen: TheFilter) -> Response:
    """Show the list, newest first."""
    listed = store.reconstructions.page(**chosen.arguments())
    return page.answer(
        "logs.html",
        chosen=chosen,
        found=listed,
        scans=store.scans.several({log.scan_id for log in listed.items}),
        scanners=store.scanners.names(),
        calibrations=_calibrations_of(store, listed.items),
        states=LOG_STATES,
        max_bytes=settings.max_upload_bytes,
        method_of=method_of,
        name_of=partial(name_of, page),
    )


@router.post("/logs/{reconstruction_id}/name", needs=Scope.SUBMIT)
def rename(reconstruction_id: Identifier, page: ThePage, store: TheStore, fields: TheForm) -> Response:
    """Name a log; an empty name takes back the one that it had."""
    try:
        named = ReconstructionName(name=fields.get("name", "").strip() or None)
    except ValidationError as error:
        return _log_page(page, store, reconstruction_id, status=422, problem=placed_complaint(error))
    store.reconstructions.rename(reconstruction_id, named.name)
    beside = fields.get("beside", "")
    return RedirectResponse(f"/logs/{reconstruction_id}{beside and '?beside=' + quote(beside)}", status_code=303)


@router.get("/logs/{reconstruction_id}")
def log(
    reconstruction_id: Identifier, page: ThePage, store: TheStore, beside: Annotated[str, Query(max_length=64)] = ""
) -> Response:
    """Show a log: its progress, why it failed, or its slices, with a second log for comparison."""
    return _log_page(page, store, reconstruction_id, beside)


def _log_page(
    page: PageFrame, store: Store, reconstruction_id: str, beside: str = "", *, status: int = 200, problem: str = ""
) -> Response:
    log = store.reconstructions.get(reconstruction_id)
    comparable = _others(store.reconstructions, log) if log.result else {}
    shown = [log, store.reconstructions.get(beside)] if beside else [log]
    jobs = [store.jobs.get(each.job_id) for each in shown]
    scanners, calibrations = store.scanners.names(), _calibrations_of(store, [*shown, *comparable.values()])
    return page.answer(
        "log.html",
        status=status,
        problem=problem,
        log=log,
        marks=[mark.model_dump(mode="json") for mark in log.marks],
        job=next((job for job in jobs if not job.state.ended), jobs[0]),
        volumes=[_volume(store.files, each, calibrations) for each in shown if each.result],
        shown=shown,
        others=comparable,
        scan=if_found(store.scans.get, log.scan_id),
        scanners=scanners,
        scanner=scanners[log.scanner_id],
        calibrations=calibrations,
        state=LOG_STATES[JobState(log.state)],
        method_of=method_of,
        color_maps=COLOR_MAPS,
        name_of=partial(name_of, page),
        stages=stages(page),
    )


def method_of(log: Reconstruction) -> ReconstructionMethod:
    """Return the method that made a log, or the requested one while there is no result."""
    used = log.result.method if log.result else None
    return used.name if used else log.options.method


def name_of(page: PageFrame, log: Reconstruction, scanner: str) -> str:
    """Return the name of a log: the one that somebody gave it, or its scanner, its number and the hour."""
    default = page.text.gettext("%(scanner)s, log %(number)s, %(time)s")
    return log.name or default % {"scanner": scanner, "number": log.number, "time": page.formats.hour(log.created_at)}


def _others(reconstructions: Reconstructions, log: Reconstruction) -> dict[str, Reconstruction]:
    """Find ready logs to compare with a log, by their ids; logs of the same scan come first."""
    same_scan = reconstructions.page(scan_id=log.scan_id, limit=_OTHERS).items
    same_scanner = reconstructions.page(scanner_id=log.scanner_id, limit=_OTHERS).items
    return {each.id: each for each in (*same_scan, *same_scanner) if each.result and each.id != log.id}


def _calibrations_of(store: Store, logs: Iterable[Reconstruction]) -> dict[str, Calibration]:
    """Find the calibrations with which logs were made, by their ids."""
    return store.calibrations.several({log.calibration_id for log in logs if log.calibration_id})


def _volume(files: MillFiles, log: Reconstruction, calibrations: Mapping[str, Calibration]) -> dict[str, Any] | None:
    """Describe where a volume's slices and pixels lie, and how well, for the viewer's script; None without its file."""
    from sawmill_formats.output.volume_reader import volume_grid  # noqa: PLC0415 - a service that shows none has no h5py

    assert log.result is not None  # noqa: S101 - the caller has checked
    try:
        grid = volume_grid(files.volume(log.id), log.result.shape)
    except NotFound:
        return None
    return {
        "id": log.id,
        "shape": grid.shape,
        "pixelMm": grid.pixel_mm,
        "firstPixelMm": grid.first_pixel_mm,
        "firstHeightMm": grid.first_height_mm,
        "spacingMm": grid.spacing_mm,
        "window": log.result.value_range,
        "unit": log.result.unit,
        **_errors_of_lengths(calibrations.get(log.calibration_id or "")),
    }


def _errors_of_lengths(calibration: Calibration | None) -> dict[str, float | None]:
    """Return how well a log's calibration knows a length, with 95 %: its scale, and the rays at either end."""
    if not isinstance(calibration, CalibrationSucceeded) or calibration.predicted_ray_error_mm is None:
        return {"scalePercent": None, "raysMm": None}
    rays_mm = calibration.predicted_ray_error_mm.upper_95
    return {"scalePercent": calibration.scale_uncertainty_percent, "raysMm": rays_mm}
