"""Plan a calibration of a scanner with a phantom."""

from typing import Any

from worker.storage.errors import NotFound
from worker.tasks.attempt import Attempt
from worker.tasks.calibrate import drawing_of
from worker.tasks.failures import refused
from worker.tasks.planning import PlanInput, run_plan


def plan(attempt: Attempt) -> dict[str, Any]:
    """Answer with the precision to expect; there are no files."""
    store = attempt.store
    asked = store.plans.get(attempt.job.subject_id)
    assert asked.options.theta is not None  # noqa: S101 - settled when it was asked for
    try:
        scanner, drawing = store.scanners.get(asked.scanner_id), drawing_of(store, asked.phantom_id)
    except NotFound as error:  # deleted since it was asked for, which a plan does not stand in the way of
        raise refused(error.code, str(error)) from error
    given = PlanInput(drawing, scanner.constants, asked.options.theta, scanner.log_radius_mm)
    return run_plan(given, asked.options).model_dump(mode="json")
