"""Pages of logs: the reconstructions, and the viewer of their slices."""

from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import Query, Response

from sawmill_contracts.reconstructions import Reconstruction
from sawmill_contracts.scans import Scan
from sawmill_platform.contracts.base import Identifier
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.errors import NotFound
from sawmill_service.dependencies import TheFiles, TheReconstructions, TheScanners, TheScans, TheStore
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.frame.page_frame import ThePage
from sawmill_service.pages.frame.words import COLOR_MAPS, LOG_STATES
from sawmill_service.pages.lists import TheFilter
from sawmill_vocabulary import ReconstructionMethod

# Number of logs for comparison from the same scan, and from the same scanner.
_OTHERS = 25

router = Router(include_in_schema=False, reading=Scope.READ)


@router.get("/logs")
def logs(
    page: ThePage, reconstructions: TheReconstructions, scanners: TheScanners, scans: TheScans, chosen: TheFilter
) -> Response:
    """Show the list, newest first."""
    listed = reconstructions.page(**chosen.arguments())
    return page.answer(
        "logs.html",
        chosen=chosen,
        found=listed,
        scans=scans.several({log.scan_id for log in listed.items}),
        scanners=scanners.names(),
        states=LOG_STATES,
        method_of=method_of,
    )


@router.get("/logs/{reconstruction_id}")
def log(
    reconstruction_id: Identifier,
    page: ThePage,
    store: TheStore,
    beside: Annotated[str, Query(max_length=64)] = "",
) -> Response:
    """Show a log: its progress, why it failed, or its slices, with a second log for comparison."""
    log = store.reconstructions.get(reconstruction_id)
    comparable = _others(store.reconstructions, log) if log.result else {}
    shown = [log, store.reconstructions.get(beside)] if beside and log.result else [log]
    scans = store.scans.several({each.scan_id for each in (*shown, *comparable.values())})
    return page.answer(
        "log.html",
        log=log,
        job=store.jobs.get(log.job_id),
        volumes=[_volume(store.files, each) for each in shown if each.result],
        shown=shown,
        others=comparable,
        scans=scans,
        scan=scans.get(log.scan_id),
        scanner=store.scanners.get(log.scanner_id).name,
        calibration=store.calibrations.get(log.calibration_id) if log.calibration_id else None,
        state=LOG_STATES[JobState(log.state)],
        method_of=method_of,
        color_maps=COLOR_MAPS,
        name_of=_name_of,
    )


def method_of(log: Reconstruction) -> ReconstructionMethod:
    """Return the method that made a log, or the requested one while there is no result."""
    used = log.result.method if log.result else None
    return used.name if used else log.options.method


def _name_of(log: Reconstruction, scans: Mapping[str, Scan]) -> str:
    """Return the name of a log's scan; the id of a scan that was deleted."""
    scan = scans.get(log.scan_id)
    return scan.name if scan else log.scan_id


def _others(reconstructions: TheReconstructions, log: Reconstruction) -> dict[str, Reconstruction]:
    """Find ready logs to compare with a log, by their ids; logs of the same scan come first."""
    same_scan = reconstructions.page(scan_id=log.scan_id, limit=_OTHERS).items
    same_scanner = reconstructions.page(scanner_id=log.scanner_id, limit=_OTHERS).items
    return {each.id: each for each in (*same_scan, *same_scanner) if each.result and each.id != log.id}


def _volume(files: TheFiles, log: Reconstruction) -> dict[str, Any] | None:
    """Describe where a volume's slices and pixels lie, for the viewer's script; None where the file is gone."""
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
    }
