"""The job that finds the marks of a log on a scanner of fixed pairs."""

from typing import Any

from sawmill_calibration.calibration.fixed_pairs import sources_of
from sawmill_calibration.drift_checks.pair_logs import log_on_pairs
from sawmill_calibration.failures import refused
from sawmill_contracts.pair_logs import PairLog
from sawmill_vocabulary import PairedScanner
from sawmill_worker.jobs.attempt import MillAttempt
from sawmill_worker.jobs.calibrate_pairs import needs

__all__ = ("needs", "run")  # the needs are those of reading the same files for a calibration


def run(attempt: MillAttempt) -> dict[str, Any]:
    """Return the places of the marks, and whether the pairs agree; no files are written."""
    options, calibrated = attempt.asked(PairLog).options, attempt.given.fixed_pairs
    assert calibrated is not None  # noqa: S101 - required by this kind of job
    if calibrated.result is None:
        detail = f"fixed-pairs {calibrated.id!r} is {calibrated.state} and has no places to use"
        raise refused("calibration-without-result", detail)
    scanner = PairedScanner(tuple(calibrated.options.pairs))
    sources = sources_of(attempt.given.files, scanner, options.data, uploaded=True)
    log = log_on_pairs(sources, scanner, calibrated.result, options.tolerance_mm, attempt.report)
    return log.model_dump(mode="json")
