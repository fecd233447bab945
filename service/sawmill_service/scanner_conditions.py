"""How each scanner stands, as the store has it: for the operator's page, and for whoever watches from outside."""

from contextlib import suppress

from sawmill_service.operator_page import ScannerCondition
from sawmill_worker.contracts.calibrations import CalibrationSucceeded, CalibrationUnfinished
from sawmill_worker.contracts.jobs import JobState
from sawmill_worker.contracts.scanners import StoredScanner
from sawmill_worker.storage.errors import NotFound
from sawmill_worker.storage.store import Store

SHOWN_SCANNERS = 200  # more than any mill has


def conditions_of(store: Store) -> list[ScannerCondition]:
    """The newest scanners first."""
    conditions = []
    for scanner in store.scanners.page(limit=SHOWN_SCANNERS).items:
        with suppress(NotFound):  # deleted a moment ago
            conditions.append(condition_of(store, scanner))
    return conditions


def condition_of(store: Store, scanner: StoredScanner) -> ScannerCondition:
    """How one of them stands."""
    last = store.calibrations.newest_ended(scanner_id=scanner.id)
    newest = last if isinstance(last, CalibrationSucceeded) else _newest_succeeded(store, scanner)
    return ScannerCondition(
        scanner=scanner,
        newest=newest,
        failure=last.failure if isinstance(last, CalibrationUnfinished) else None,
        drift=store.drifts.newest_ended(scanner_id=scanner.id),
        history=store.scanners.history(scanner.id, limit=20),
    )


def _newest_succeeded(store: Store, scanner: StoredScanner) -> CalibrationSucceeded | None:
    found = store.calibrations.page(scanner_id=scanner.id, state=JobState.SUCCEEDED, limit=1).items
    return next((item for item in found if isinstance(item, CalibrationSucceeded)), None)
