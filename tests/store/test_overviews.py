"""What is newest of each scanner, on each database."""

import pytest

from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_contracts.drifts import DriftAsk
from sawmill_contracts.history import HistoryKind
from sawmill_contracts.scanners import ScannerSpec
from sawmill_mill.decisions import Decisions
from sawmill_platform.contracts.jobs import Failure, FailureKind
from sawmill_platform.errors import Conflict

pytestmark = pytest.mark.slow


@pytest.mark.dialect
def test_each_scanner_has_what_is_newest_of_it(store, scanner, ready_scan, finish):
    other = store.scanners.create(ScannerSpec(name="Line 9", constants=scanner.constants))
    ask = CalibrationAsk(scan_id=ready_scan.id, phantom_id="l-shape", activate=True)
    store.calibrations.accept(ask, identifier="first")
    finish(store)
    saw = store.drifts.accept(DriftAsk(scan_id=ready_scan.id))
    finish(store)
    drift = store.drifts.accept(DriftAsk(scan_id=ready_scan.id))
    store.jobs.fail(store.jobs.claim("test"), Failure(kind=FailureKind.INPUT, code="no-log", detail="none"))
    store.calibrations.accept(ask, identifier="second")
    store.jobs.fail(store.jobs.claim("test"), Failure(kind=FailureKind.INPUT, code="phantom-not-seen", detail="none"))
    store.calibrations.accept(ask, identifier="third")

    new, seen = sorted(store.overviews.read(), key=lambda each: each.scanner.name == scanner.name)
    assert (seen.ended_id, seen.succeeded_id) == ("second", "first")
    assert (seen.drift_id, seen.seen_id) == (drift.id, saw.id)
    assert (seen.scan_id, seen.calibrating, seen.scanner.active_calibration_id) == (ready_scan.id, True, "first")
    assert new == (store.scanners.get(other.id), None, None, None, None, None, False, None, None, Decisions())
    assert store.overviews.read(scanner_id=other.id) == [new]
    assert store.calibrations.several(["first", "nothing"]) == {"first": store.calibrations.get("first")}


@pytest.mark.dialect
def test_the_last_decisions_are_those_of_its_own_calibrations(store, scanner, ready_scan, finish):
    asks = {name: CalibrationAsk(scan_id=ready_scan.id, phantom_id="l-shape") for name in ("used", "better", "wrong")}
    for name, ask in asks.items():
        store.calibrations.accept(ask, identifier=name)
        finish(store)
    store.calibrations.activate("used", "by hand")

    def decisions():
        (overview,) = store.overviews.read(scanner_id=scanner.id)
        return overview.decisions

    assert (decisions().activated_at is None, decisions().discarded_at) == (False, None)
    store.calibrations.accept(asks["wrong"], identifier="failed")
    with pytest.raises(Conflict, match="is queued: cancel its job"):
        store.calibrations.discard("failed", "wrong file")
    store.jobs.fail(store.jobs.claim("test"), Failure(kind=FailureKind.INPUT, code="phantom-not-seen", detail="none"))
    store.calibrations.discard("failed", "wrong file")
    assert (decisions().discarded_at is None, decisions().result_discarded_at) == (False, None)
    store.calibrations.discard("wrong", "wrong phantom")
    store.calibrations.discard("wrong", "a second click")
    assert decisions().result_discarded_at == decisions().discarded_at
    with pytest.raises(Conflict, match="is in use"):
        store.calibrations.discard("used", "by mistake")
    entries = store.history.page(scanner.id, kind=HistoryKind.DISCARD).items
    assert [(entry.subject_id, entry.why) for entry in entries] == [
        ("wrong", "wrong phantom"),
        ("failed", "wrong file"),
    ]
    assert store.history.newest(scanner.id, HistoryKind.DISCARD, "failed") == entries[1]
