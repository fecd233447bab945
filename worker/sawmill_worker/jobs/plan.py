"""Plan a calibration of a scanner with a phantom."""

from typing import Any

from sawmill_worker.contracts.phantoms import PhantomDrawing
from sawmill_worker.contracts.plans import Plan
from sawmill_worker.contracts.scanners import StoredScanner
from sawmill_worker.jobs.attempt import Attempt
from sawmill_worker.jobs.calibrate import drawing_of
from sawmill_worker.jobs.needs import PROCESS_BYTES, SINOGRAMS, Needs
from sawmill_worker.storage.errors import NotFound
from sawmill_worker.storage.store import Store
from sawmill_worker.use_cases.failures import refused
from sawmill_worker.use_cases.plan import PlanInput, run_plan


def run(attempt: Attempt) -> dict[str, Any]:
    """Answer with the precision to expect; there are no files."""
    store = attempt.store
    asked = store.plans.get(attempt.job.subject_id)
    assert asked.options.theta is not None  # noqa: S101 - settled when it was asked for
    scanner, drawing = _scanner_and_drawing(store, asked)
    given = PlanInput(drawing, scanner.constants, asked.options.theta, scanner.log_radius_mm)
    return run_plan(given, asked.options).model_dump(mode="json")


def needs(attempt: Attempt) -> Needs:
    """Of the phantom's sinogram."""
    asked = attempt.store.plans.get(attempt.job.subject_id)
    scanner, _ = _scanner_and_drawing(attempt.store, asked)
    cells = scanner.constants.num_detector_pixels
    return Needs(PROCESS_BYTES + SINOGRAMS * 8 * asked.options.views * cells, 0)


def _scanner_and_drawing(store: Store, asked: Plan) -> tuple[StoredScanner, PhantomDrawing]:
    """Of a plan; refused where one was deleted since it was asked for, which a plan does not stand in the way of."""
    try:
        return store.scanners.get(asked.scanner_id), drawing_of(store, asked.phantom_id)
    except NotFound as error:
        raise refused(error.code, str(error)) from error
