"""An inspected file is kept for a day, and for as long as it waits to be inspected."""

import pytest

from sawmill_contracts import kinds
from sawmill_contracts.inspections import FILE_KEPT, InspectionOptions
from sawmill_contracts.scans import ScanSpec
from sawmill_vocabulary import DataKind

pytestmark = pytest.mark.clocked

GRACE_S = 3600.0


@pytest.fixture
def looked(store):
    """What goes at two looks, a grace apart."""

    def look():
        now_s = 0.0
        observer = store.leftovers(grace_s=GRACE_S, now_s=lambda: now_s)
        observer.remove_some()
        now_s = 2.0 * GRACE_S
        return observer.remove_some()

    return look


def inspect(store):
    return store.inspections.accept_file(InspectionOptions(), store.files.receive([b"scan"], max_bytes=10))


def test_a_file_goes_a_day_after_it_came_and_the_answer_stays(store, clock, looked, finish):
    inspected = inspect(store)
    finish(store)
    assert inspected.file_kept_until == clock.now + FILE_KEPT
    clock.advance(seconds=FILE_KEPT.total_seconds() - 1.0)
    assert looked() == []
    clock.advance(seconds=2.0)
    assert looked() == [store.files.upload(kinds.INSPECT, inspected.id).parent]
    assert store.inspections.get(inspected.id).result.verdict == "incomplete"


def test_a_file_stays_until_it_has_been_inspected(store, clock, looked, finish):
    inspected = inspect(store)
    clock.advance(days=3)
    assert looked() == []
    finish(store)
    assert looked() == [store.files.upload(kinds.INSPECT, inspected.id).parent]


def test_a_scan_keeps_its_file_when_that_of_the_inspection_goes(store, clock, looked, finish, scanner):
    inspected = inspect(store)
    finish(store)
    spec = ScanSpec(scanner_id=scanner.id, data=DataKind.COUNTS)
    scan = store.scans.accept(spec, store.inspections.received_again(inspected.id))
    clock.advance(days=2)
    looked()
    assert store.files.upload(kinds.INGEST, scan.id).read_bytes() == b"scan"
