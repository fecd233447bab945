"""The job that calibrates a scanner of fixed pairs."""

from typing import Any

from sawmill_calibration.calibration.fixed_pairs import calibrate_passages, sources_of
from sawmill_contracts.fixed_pairs import FixedPairs, FixedPairsOptions
from sawmill_formats.input.arrays import MAX_BYTES
from sawmill_platform.attempts.protocol import Needs
from sawmill_vocabulary import PairedScanner
from sawmill_worker.jobs.attempt import FILE_BYTES, FILE_SHARE, MillAttempt
from sawmill_worker.jobs.calibrate import drawing_of


def run(attempt: MillAttempt) -> dict[str, Any]:
    """Return the places of all pairs; no files are written."""
    options = attempt.asked(FixedPairs).options
    scanner = PairedScanner(tuple(options.pairs))
    limits = FixedPairsOptions(**options.model_dump(include=set(FixedPairsOptions.model_fields)))
    sources = sources_of(attempt.given.files, scanner, options.data, uploaded=True)
    return calibrate_passages(sources, scanner, drawing_of(attempt), limits, attempt.report).model_dump(mode="json")


def needs(_: MillAttempt) -> Needs:
    """Return no needs of memory beyond the common limits: sizes that a file declares are not trusted."""
    return Needs(0, int(FILE_SHARE * MAX_BYTES) + FILE_BYTES)
