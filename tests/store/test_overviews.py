"""What is newest of each scanner, on each database."""

from collections import defaultdict
from datetime import timedelta
from itertools import chain, product

import pytest
from sqlalchemy import insert

from sawmill_contracts import mill_events
from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.drifts import DriftRequest
from sawmill_contracts.history import HistoryKind
from sawmill_contracts.kinds import CALIBRATE
from sawmill_contracts.measurements import MeasurementKind
from sawmill_contracts.scanners import ScannerSpec
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.database.tables import EventRow, JobRow
from sawmill_platform.errors import Conflict
from sawmill_store.mill_tables import ActivationRow, CalibrationRow, MeasurementRow, ScannerRow

pytestmark = pytest.mark.slow


@pytest.mark.dialect
def test_each_scanner_has_what_is_newest_of_it(store, scanner, ready_scan, finish, refuse):
    other = store.scanners.create(ScannerSpec(name="Line 9", constants=scanner.constants))
    ask = CalibrationRequest(scan_id=ready_scan.id, phantom_id="l-shape", activate=True)
    store.calibrations.accept(ask, identifier="first")
    finish(store)
    saw = store.drifts.accept(DriftRequest(scan_id=ready_scan.id))
    finish(store)
    drift = store.drifts.accept(DriftRequest(scan_id=ready_scan.id))
    refuse()
    store.calibrations.accept(ask, identifier="second")
    refuse()
    store.calibrations.accept(ask, identifier="third")
    new, seen = sorted(store.overviews.read(), key=lambda each: each.scanner.name == scanner.name)
    assert (seen.ended_id, seen.succeeded_id) == ("second", "first")
    assert (seen.drift_id, seen.seen_id) == (drift.id, saw.id)
    assert (seen.scan_id, seen.calibrating, seen.scanner.active_calibration_id) == (ready_scan.id, True, "first")
    assert new == (store.scanners.get(other.id), *[None] * 6, False, None)
    assert store.overviews.read(scanner_id=other.id) == [new]
    assert store.calibrations.several(["first", "nothing"]) == {"first": store.calibrations.get("first")}


@pytest.mark.dialect
def test_a_discarded_calibration_is_left_out_and_told(store, scanner, ready_scan, finish, refuse):
    asks = {
        name: CalibrationRequest(scan_id=ready_scan.id, phantom_id="l-shape") for name in ("used", "better", "wrong")
    }
    for name, ask in asks.items():
        store.calibrations.accept(ask, identifier=name)
        finish(store)
        if name == "used":
            store.calibrations.activate("used", "by hand")

    def undecided():
        (overview,) = store.overviews.read(scanner_id=scanner.id)
        return overview.ended_id, overview.succeeded_id, overview.discarded_at is not None

    assert undecided() == ("wrong", "wrong", False)
    store.calibrations.accept(asks["wrong"], identifier="failed")
    with pytest.raises(Conflict, match="is queued: cancel its job"):
        store.calibrations.discard("failed", "wrong file")
    refuse()
    assert undecided() == ("failed", "wrong", False)
    store.calibrations.discard("failed", "wrong file")
    assert undecided() == ("wrong", "wrong", True)
    store.calibrations.discard("wrong", "wrong phantom")
    store.calibrations.discard("failed", "a second click")
    assert undecided() == ("better", "better", True)
    with pytest.raises(Conflict, match="is in use"):
        store.calibrations.discard("used", "by mistake")
    entries = store.history.page(scanner.id, kind=HistoryKind.DISCARD).items
    decided = [(entry.subject_id, entry.why) for entry in entries]
    assert decided == [("wrong", "wrong phantom"), ("failed", "wrong file")]
    assert store.history.newest(scanner.id, HistoryKind.DISCARD, "failed") == entries[1]
    store.calibrations.activate("better", "by hand")
    assert undecided() == (None, "better", False)


ZEROS = dict.fromkeys(("cor_column_mm", "tilt_rad", "source_to_detector_mm", "relative_residual"), 0.0)
# What can happen next: a calibration that is good, whose rays fail, that shows a movement, or that has no result; the
# newest undecided one is accepted; the newest or the one before it is discarded.
LETTERS = ("good", "fail", "moved", "none", "accept", "discard", "discard before")


def played(letters):
    """What happens in a history; the ids of a plain model: the active one, the newest ended, succeeded and red one."""
    active, undecided, rows = None, [], []
    for at, letter in enumerate(letters):
        with_result = [each for each in undecided if each[1] != "none"]
        if letter == "accept":
            if not with_result:
                return None
            active, undecided = with_result[-1], []
            rows.append((ActivationRow, at, active[0], None))
        elif letter.startswith("discard"):
            place = -1 if letter == "discard" else -2
            if len(undecided) < -place:
                return None
            rows.append((EventRow, at, undecided.pop(place)[0], None))
        else:
            # A comparison is with the calibration that is active then.
            undecided.append((f"{letter}-{at}", letter, active and active[0]))
            rows.append((CalibrationRow, at, *undecided[-1][::2]))
    with_result = [each for each in undecided if each[1] != "none"]
    red = [each for each in with_result if each[1] == "fail" or (each[1] == "moved" and active)]
    newest = undecided, with_result or ([active] if active else []), red
    return rows, active and active[0], *(each[-1][0] if each else None for each in newest)


def rows_of(name, history, start):
    """The rows of a history of a scanner, each with its table; its ids begin with the scanner's."""
    for table, hour, identifier, against in history:
        subject, at = f"{name}-{identifier}", start + timedelta(hours=hour)
        mine, row = {"scanner_id": name}, {"id": subject, "created_at": at}
        if table is ActivationRow:
            yield table, mine | {"calibration_id": subject, "activated_at": at, "reason": "by hand"}
        elif table is EventRow:
            what = {"type": mill_events.CALIBRATION_DISCARDED, "topic": "discard", "event_class": "decision"}
            yield table, what | {"at": at, "group_id": name, "subject_id": subject}
        else:
            letter, ended_at = identifier.split("-")[0], at + timedelta(minutes=1)
            state = JobState.FAILED if letter == "none" else JobState.SUCCEEDED
            yield JobRow, row | {"kind": CALIBRATE, "state": state, "subject_id": subject, "finished_at": ended_at}
            asked = {"phantom_id": "l-shape", "scan_id": "scan", "options": {}, "activate": False, "job_id": subject}
            yield table, row | mine | asked
            if letter != "none":
                measured = {"kind": MeasurementKind.CALIBRATION, "at": ended_at, "subject_id": subject}
                verdicts = {"verdict": "fail" if letter == "fail" else "pass", "within_tolerance": letter != "moved"}
                verdicts |= {"against_id": against and f"{name}-{against}"}
                yield MeasurementRow, mine | measured | verdicts | ZEROS


@pytest.mark.clocked
def test_every_history_to_length_four_has_the_newest_undecided_results_of_a_plain_model(store, scanner):
    """The rows of all histories are written at once, with a scanner for each."""
    words = chain.from_iterable(product(LETTERS, repeat=length) for length in range(5))
    histories = {f"s{number}": played(letters) for number, letters in enumerate(words)}
    histories = {name: history for name, history in histories.items() if history is not None}
    start, tables = store.now(), defaultdict(list)
    spec = scanner.model_dump(mode="json", include=set(ScannerSpec.model_fields))
    for name, (history, *_) in histories.items():
        tables[ScannerRow].append({"id": name, "created_at": start, "spec": spec})
        for table, row in rows_of(name, history, start):
            tables[table].append(row)
    with store.database.write() as session:
        for table in (ScannerRow, JobRow, CalibrationRow, ActivationRow, EventRow, MeasurementRow):
            session.execute(insert(table), tables[table])
    found = {each.scanner.id: each for each in store.overviews.read(limit=len(histories) + 1)}
    for name, (_, *ids) in histories.items():
        seen = found[name]
        newest = seen.scanner.active_calibration_id, seen.ended_id, seen.succeeded_id, seen.red_id
        assert newest == tuple(identifier and f"{name}-{identifier}" for identifier in ids), name
