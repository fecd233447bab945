"""A mill in which every state of a page exists at once, made of a seeded store without any science."""

from typing import Any, Protocol

from results import comparison

from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.drifts import DriftRequest
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.inspections import InspectionOptions
from sawmill_contracts.phantoms import MeasurementsRequest, PhantomPicture, SizeMeasurement
from sawmill_contracts.reasons import CodedReason
from sawmill_contracts.reconstructions import ReconstructionRequest
from sawmill_contracts.scanners import AlarmLimits, ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.contracts.jobs import Failure, FailureKind
from sawmill_platform.contracts.webhooks import WebhookRequest
from sawmill_platform.jobs.job_store import Claim
from sawmill_store.store import Store
from sawmill_vocabulary import DataKind, Progress
from sawmill_vocabulary.calibration_messages import CalibrationMessage
from sawmill_vocabulary.movement_messages import LogMessage, MovementMessage

SCANNER, PHANTOM = "sorting-line-4", "l-shape"
NAME = "Sorting line 4, log scanner behind the debarker (Pohjois-Karjala)"
MOVED = MovementMessage.MOVED(MovementMessage.TURNTABLE(column_mm=-2.12), moved_mm=0.66, allowed_mm=0.5)
SLIPPED = CalibrationMessage.PHANTOM_SLIPPED(CalibrationMessage.LOG_DISAGREES(column_mm=2.5, tilt_deg=0.02))
NOTHING_MOVED = LogMessage.NOTHING_MOVED(column_error_mm=0.04, tilt_error_deg=0.01)


def of(reason: str) -> dict[str, Any]:
    """A reason as a worker stores it, with its code."""
    return {"reason": reason, "coded_reason": CodedReason.of(reason).model_dump(mode="json")}


def all_of(*reasons: str) -> dict[str, Any]:
    return {"reasons": [*reasons], "coded_reasons": [of(each)["coded_reason"] for each in reasons]}


COMPARISON = comparison(
    0.66, calibration_id="passed", scale_change_percent=0.12, cor_column_change_mm=-2.12, **of(MOVED)
)
FAILURE = Failure(
    kind=FailureKind.INPUT,
    code="phantom-not-seen",
    detail="the phantom 'L-shape' was not found: the best geometry leaves 31% of the sinogram unexplained",
)


class Finisher(Protocol):
    def claim(self) -> Claim: ...
    def finish_scan(self) -> None: ...
    def finish_tracing(self) -> None: ...
    def finish_calibration(self, **changes: Any) -> None: ...
    def finish_drift(self, **changes: Any) -> None: ...
    def finish_inspection(self, **changes: Any) -> None: ...


def fill(store: Store, worker: Finisher, language: str = "en") -> dict[str, str]:
    """Bring a seeded store into every state; return the paths of the pages by the names of the states."""
    _scans_and_calibrations(store, worker)
    _inspected(store, "refused")
    worker.finish_inspection(verdict="refused", missing=[], reading=None, refusal=FAILURE.model_dump(mode="json"))
    picture = PhantomPicture(name="the cross of the hall", width_mm=400)
    for identifier in ("traced", "untraced"):
        store.phantoms.accept_picture(picture, store.files.receive([b"PNG"], max_bytes=100), phantom_id=identifier)
    worker.finish_tracing()
    store.jobs.fail(worker.claim(), Failure(kind=FailureKind.INPUT, code="no-signal", detail=str(SLIPPED)))
    store.webhooks.create(
        WebhookRequest(url="https://alarms.mill.example/" + "long/" * 30, description=NAME, enabled=True)
    )
    store.alarms.check()
    measured = SizeMeasurement(dimension="x", measured_mm=199.8, standard_uncertainty_mm=0.15, instrument="caliper 12")
    measured_id = store.phantoms.measure("l-shape", MeasurementsRequest(measurements=[measured])).id
    _unfinished(store, worker)
    lists = ("scans", "logs", "phantoms", "jobs", "system", "audit", "retention")
    results = ("passed", "watched", "moved", "slipped", "failed", "queued")
    return {
        **{name: f"/{name}" for name in lists},
        "today": "/",
        "kiosk": "/?kiosk",
        "scanner": f"/scanners/{SCANNER}?days=90",
        "scanner-failed": "/scanners/example",
        "scanner-new": "/scanners/example-spare",
        "history": f"/scanners/{SCANNER}/history",
        "new-scanner": "/scanners/new",
        "file": f"/calibrate?scanner={SCANNER}",
        "inspecting": "/calibrate?inspection=waiting",
        "questions": "/calibrate?inspection=example",
        "refused": "/calibrate?inspection=refused",
        **{f"calibration-{each}": f"/calibrate?calibration={each}" for each in results},
        **{f"report-{each}": f"/calibrations/{each}/report?language={language}" for each in results[:4]},
        "scan": "/scans/example",
        "scan-refused": "/scans/unreadable",
        "log": "/logs/example",
        "log-compared": "/logs/example?beside=example-sparse",
        "log-failed": "/logs/failed",
        "log-queued": "/logs/queued",
        "phantom": "/phantoms/l-shape",
        "phantom-measured": f"/phantoms/{measured_id}",
        "phantom-traced": "/phantoms/traced",
        "phantom-refused": "/phantoms/untraced",
        "new-phantom": "/phantoms/new",
        "webhooks": "/system/webhooks",
        "problems": "/problems/",
        "problem": "/problems/phantom-not-seen",
        "nothing": "/nothing/here",
    }


def _scans_and_calibrations(store: Store, worker: Finisher) -> None:
    constants = ScannerConstants(source_to_cor_mm=859.46, num_detector_pixels=16, detector_pitch_mm=1.5)
    store.scanners.create(
        ScannerSpec(name=NAME, constants=constants, alarms=AlarmLimits(quiet_after_hours=1)), scanner_id=SCANNER
    )
    spec = ScanSpec(
        scanner_id=SCANNER,
        data=DataKind.LINE_INTEGRALS,
        phantom_id=PHANTOM,
        name="line-4_2026-11-26_0557_phantom-and-log.nxs",
    )
    store.scans.accept(spec, store.files.receive([b"a scan"], max_bytes=100), scan_id="scan")
    worker.finish_scan()
    store.scans.accept(spec, store.files.receive([b"no scan"], max_bytes=100), scan_id="unreadable")
    store.jobs.fail(worker.claim(), Failure(kind=FailureKind.INPUT, code="broken-file", detail=str(SLIPPED)))
    _calibrated(store, worker, "passed", activate=True)
    for number in range(12):
        store.drifts.accept(DriftRequest(scan_id="scan"))
        worker.finish_drift(ray_change_mm=0.02 + 0.03 * number, **of(NOTHING_MOVED))
    _calibrated(store, worker, "watched", verdict="watch", rays_verdict="watch", **all_of(SLIPPED, MOVED))
    _calibrated(store, worker, "slipped", verdict="fail", rays_verdict="fail", **all_of(SLIPPED))
    _calibrated(store, worker, "moved", comparison=COMPARISON, **all_of(MOVED))
    store.drifts.accept(DriftRequest(scan_id="scan"))
    worker.finish_drift(within_tolerance=False, ray_change_mm=0.8, **of(MOVED))
    store.calibrations.accept(CalibrationRequest(scan_id="example"), identifier="failed")
    store.jobs.fail(worker.claim(), FAILURE)
    store.reconstructions.accept(ReconstructionRequest(scan_id="example"), identifier="failed")
    store.jobs.fail(worker.claim(), Failure(kind=FailureKind.INPUT, code="out-of-memory", detail=str(SLIPPED)))


def _calibrated(store: Store, worker: Finisher, identifier: str, *, activate: bool = False, **changes: Any) -> None:
    store.calibrations.accept(CalibrationRequest(scan_id="scan", activate=activate), identifier=identifier)
    worker.finish_calibration(**changes)


def _inspected(store: Store, identifier: str) -> None:
    received = store.files.receive([b"a file"], max_bytes=100)
    name = "IMG_20261126_055712_line_4_phantom_and_log.jpg"
    store.inspections.accept_file(InspectionOptions(), received, name=name, identifier=identifier)


def _unfinished(store: Store, worker: Finisher) -> None:
    """Leave one job running and others in the queue, which nothing may claim later."""
    store.reconstructions.accept(ReconstructionRequest(scan_id="example"), identifier="queued")
    store.jobs.heartbeat(worker.claim(), Progress(fraction=0.4, stage="reconstruct", seconds_left=75.0))
    store.calibrations.accept(CalibrationRequest(scan_id="scan"), identifier="queued")
    _inspected(store, "waiting")
