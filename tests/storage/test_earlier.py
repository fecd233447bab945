"""The same asked for again is answered from the earlier result, and what differs in anything is computed."""

import os
from concurrent.futures import ThreadPoolExecutor
from datetime import date, datetime
from pathlib import Path
from types import SimpleNamespace

import pytest
from results import RESULTS

from sawmill_worker.contracts.calibrations import CalibrationAsk
from sawmill_worker.contracts.drifts import DriftAsk
from sawmill_worker.contracts.events import EventKind
from sawmill_worker.contracts.handed_over import HandedOver
from sawmill_worker.contracts.history import HistoryKind
from sawmill_worker.contracts.inspections import InspectionOptions
from sawmill_worker.contracts.jobs import Failure, FailureKind, JobKind, JobState
from sawmill_worker.contracts.kinds import AskedKind, asked_kinds, declaration_of
from sawmill_worker.contracts.phantoms import SizeMeasurement
from sawmill_worker.contracts.plans import PlanAsk
from sawmill_worker.contracts.reconstructions import ReconstructionAsk
from sawmill_worker.contracts.scanners import ScannerSpec
from sawmill_worker.contracts.scans import ScanSpec
from sawmill_worker.storage import earlier, origins
from sawmill_worker.storage.leftovers import Leftovers
from sawmill_worker.storage.origins import origin_of
from sawmill_worker.storage.software import software
from sawmill_worker.storage.store import Store
from sawmill_worker.vocabulary import DataKind, Theta

NOMINAL = Theta(
    initial_angle_rad=0.0, detector_to_cor_mm=740.0, source_shift_mm=200.0, detector_shift_mm=30.0, detector_tilt=0.2
)
KILLED = 9


@pytest.fixture
def compute(store):
    """Do the oldest job as a worker whose software is known, without any science."""

    def do(by=None, **changes):
        claim = store.jobs.claim("test")
        kind, output = claim.job.kind, store.files.make_attempt_folder(claim.job_id, claim.attempt)
        declared = declaration_of(kind)
        for name in declared.leaves if isinstance(declared, AskedKind) else ["scan.h5"]:
            (output / name).write_text(f"of {claim.job.subject_id}")
        origin = origin_of(kind, store.jobs.handed_over(claim.job_id), by or software())
        store.jobs.succeed(claim, RESULTS[kind](**changes), output, origin=origin)
        return claim.job.subject_id

    return do


@pytest.fixture
def scanned(store, scanner, compute):
    """Upload a scan and read it."""

    def upload(content=b"scan", by=None, **spec):
        given = ScanSpec(scanner_id=scanner.id, data=DataKind.COUNTS, phantom_id="l-shape", **spec)
        accepted = store.scans.accept(given, store.files.receive([content], max_bytes=10))
        compute(by)
        return accepted.id

    return upload


@pytest.fixture
def calibrate(store):
    return lambda scan_id, **options: store.calibrations.accept(CalibrationAsk(scan_id=scan_id, **options))


@pytest.fixture
def plan(store, scanner):
    def ask(phantom_id="l-shape", **options):
        return store.plans.accept(
            PlanAsk(scanner_id=scanner.id, theta=NOMINAL, **options), given={"phantom_id": phantom_id}
        )

    return ask


def result_file(store: Store, calibration_id: str) -> Path:
    return store.files.results(JobKind.CALIBRATE, calibration_id) / "result.h5"


def states(*answers):
    return [(answer.state, answer.answered_from) for answer in answers]


def test_the_same_is_answered_at_once_under_its_own_id_with_its_own_files(store, scanned, calibrate, compute):
    scan_id = scanned()
    first = calibrate(scan_id)
    assert states(first) == [("queued", None)]
    compute()
    second = calibrate(scan_id)
    assert states(store.calibrations.get(first.id), second) == [("succeeded", None), ("succeeded", first.id)]
    assert second.id != first.id
    assert store.calibrations.get(second.id) == second
    computed = store.calibrations.get(first.id)
    assert (second.theta, second.timing_s) == (computed.theta, computed.timing_s)
    files = [result_file(store, each.id) for each in (first, second)]
    assert files[1].samefile(files[0])
    assert files[1].read_text() == f"of {first.id}"
    job = store.jobs.get(second.job_id)
    assert (job.state, job.answered_from, job.attempt, job.started_at) == (JobState.SUCCEEDED, first.id, 0, None)
    assert job.finished_at == job.created_at
    events = [event for event in store.events.following(0) if event.job_id == job.id]
    assert [(event.what, event.subject_id) for event in events] == [
        (EventKind.QUEUED, second.id),
        (EventKind.SUCCEEDED, second.id),
    ]
    assert events[-1].detail == {"answered_from": first.id}
    assert store.jobs.claim("test") is None
    assert list((store.files.folder / "attempts").iterdir()) == []


def test_every_kind_that_is_asked_for_takes_fresh(store, scanned, calibrate, compute, plan):
    assert all(declared.ask.model_fields["fresh"].default is False for declared in asked_kinds())
    scan_id = scanned()
    calibrate(scan_id)
    calibration_id = compute()

    def inspect(**fresh):
        return store.inspections.accept_file(InspectionOptions(), store.files.receive([b"scan"], max_bytes=9), **fresh)

    asked = {
        "calibration": lambda **fresh: calibrate(scan_id, views=10, **fresh),
        "reconstruction": lambda **fresh: store.reconstructions.accept(
            ReconstructionAsk(scan_id=scan_id, calibration_id=calibration_id, **fresh)
        ),
        "drift": lambda **fresh: store.drifts.accept(DriftAsk(scan_id=scan_id, calibration_id=calibration_id, **fresh)),
        "plan": plan,
        "inspection": inspect,
    }
    assert asked.keys() == {declared.noun for declared in asked_kinds()}
    for ask in asked.values():
        first = ask()
        compute()
        assert states(ask()) == [("succeeded", first.id)]
        again = ask(fresh=True)
        assert states(again) == [("queued", None)]
        compute()
        assert states(ask()) == [("succeeded", again.id)], "the newest"


def test_whatever_was_answered_names_the_one_that_was_computed(store, scanned, calibrate, compute):
    scan_id = scanned()
    first = calibrate(scan_id)
    compute()
    second, third = calibrate(scan_id), calibrate(scan_id)
    assert states(second, third) == [("succeeded", first.id)] * 2
    result_file(store, first.id).unlink()
    assert states(calibrate(scan_id)) == [("succeeded", first.id)], "with the files of another that it answered"
    assert result_file(store, second.id).read_text() == f"of {first.id}"


def test_a_result_whose_files_are_gone_is_computed_again(store, scanned, calibrate, compute):
    scan_id = scanned()
    first = calibrate(scan_id)
    compute()
    result_file(store, first.id).unlink()
    assert states(calibrate(scan_id)) == [("queued", None)]


def test_the_same_file_under_another_id_is_the_same_input(scanned, calibrate, compute):
    first = calibrate(scanned())
    compute()
    assert states(calibrate(scanned(name="the same again"))) == [("succeeded", first.id)]


@pytest.mark.parametrize(
    "other",
    [{"content": b"other"}, {"angles_deg": "0:1"}, {"phantom_rows": "0:1"}, {"by": "an earlier version"}],
    ids=["content", "angles", "rows", "read by another version"],
)
def test_another_scan_is_computed(scanned, calibrate, compute, other):
    calibrate(scanned())
    compute()
    assert states(calibrate(scanned(**other))) == [("queued", None)]


def test_other_options_another_phantom_and_another_version_are_computed(scanned, calibrate, compute, monkeypatch):
    scan_id = scanned()
    calibrate(scan_id)
    compute()
    assert (
        states(calibrate(scan_id, seed=8), calibrate(scan_id, phantom_id="rectangle-with-hole"))
        == [("queued", None)] * 2
    )
    monkeypatch.setattr(earlier, "software", lambda: "0.0.1+0123456789abcdef")
    assert states(calibrate(scan_id)) == [("queued", None)]


def test_what_the_scanner_is_and_may_be_counts_and_what_it_is_called_does_not(
    store, scanner, scanned, calibrate, compute
):
    scan_id = scanned()
    first = calibrate(scan_id)
    compute()
    spec = ScannerSpec(name="Line 3", constants=scanner.constants)
    store.scanners.update(scanner.id, spec)
    assert states(calibrate(scan_id)) == [("succeeded", first.id)]
    store.scanners.update(scanner.id, spec.model_copy(update={"log_radius_mm": 120.0}))
    assert states(calibrate(scan_id)) == [("queued", None)]


def test_what_failed_or_was_cancelled_answers_nothing(store, plan):
    first, second = plan(), plan(views=20)
    store.jobs.request_cancel(second.job_id)
    claim = store.jobs.claim("test")
    assert claim.job.subject_id == first.id
    store.jobs.fail(claim, Failure(kind=FailureKind.INPUT, code="too-slow", detail="it took too long"))
    assert states(plan(), plan(views=20)) == [("queued", None)] * 2


def test_a_result_of_unknown_software_answers_nothing(store, plan, finish):
    plan()
    finish(store)
    assert states(plan()) == [("queued", None)]


def test_an_answered_calibration_is_activated_on_pass_as_a_computed_one(store, scanner, scanned, calibrate, compute):
    scan_id = scanned()
    first = calibrate(scan_id)
    compute()
    assert store.scanners.get(scanner.id).active_calibration_id is None
    second = calibrate(scan_id, activate=True)
    assert states(second) == [("succeeded", first.id)]
    assert store.scanners.get(scanner.id).active_calibration_id == second.id
    activations = store.history.page(scanner.id, kind=HistoryKind.ACTIVATION).items
    assert [each.subject_id for each in activations] == [second.id]
    assert len(store.measurements.page(scanner.id).items) == 2
    third = calibrate(scan_id, activate=True)
    assert states(third) == [("queued", None)], "it is compared with the one that is active by now"


def test_a_failing_verdict_is_not_activated(store, scanner, scanned, calibrate, compute):
    scan_id = scanned()
    first = calibrate(scan_id)
    compute(verdict="fail")
    assert states(calibrate(scan_id, activate=True)) == [("succeeded", first.id)]
    assert store.scanners.get(scanner.id).active_calibration_id is None


def test_a_calibration_counts_by_what_it_found(store, scanned, calibrate, compute):
    scan_id = scanned()
    calibrations = [calibrate(scan_id, fresh=True) for _ in range(3)]
    compute(timing_s={"total": 1.0, "search": 0.5, "refine": 0.4, "uncertainty": 0.1})
    compute(timing_s={"total": 2.0, "search": 0.5, "refine": 0.4, "uncertainty": 1.1})
    compute(gain=2.0)

    def check(calibration):
        return store.drifts.accept(DriftAsk(scan_id=scan_id, calibration_id=calibration.id))

    first = check(calibrations[0])
    compute()
    same, other = check(calibrations[1]), check(calibrations[2])
    assert states(same, other) == [("succeeded", first.id), ("queued", None)]
    assert same.calibration_id == calibrations[1].id
    assert store.measurements.page(same.scanner_id).items[0].against_id == calibrations[1].id


def test_a_plan_does_not_depend_on_what_is_active(scanned, calibrate, plan, compute):
    first = plan()
    compute()
    calibrate(scanned(), activate=True)
    compute()
    assert states(plan()) == [("succeeded", first.id)]


def test_while_a_scan_is_read_what_waits_for_it_is_queued(store, upload, calibrate, scanned, compute):
    calibrate(scanned())
    compute()
    assert states(calibrate(upload(store).id)) == [("queued", None)]


def test_where_files_have_no_second_names_it_is_computed(store, scanned, calibrate, compute, monkeypatch):
    scan_id = scanned()
    first = calibrate(scan_id)
    compute()

    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(Path, "hardlink_to", refuse)
    second = calibrate(scan_id)
    assert states(second) == [("queued", None)]
    claim = store.jobs.claim("test")
    output = store.files.make_attempt_folder(claim.job_id, claim.attempt)
    assert not store.files.take_over(claim.job.kind, first.id, output)
    assert list(output.iterdir()) == []


def test_the_day_on_which_a_measurement_expires_counts(store, monkeypatch):
    drawing = store.phantoms.get("l-shape").drawing
    measured = SizeMeasurement(what="x", measured_mm=200.0, standard_uncertainty_mm=0.1, expires_on=date(2026, 4, 1))
    phantom = store.phantoms.get("l-shape").model_copy(
        update={"drawing": drawing.model_copy(update={"measurements": [measured]})}
    )
    given = HandedOver(phantom=phantom, kept=Path("kept"))

    def on(day):
        monkeypatch.setattr(origins, "datetime", SimpleNamespace(now=lambda _: datetime.fromisoformat(day)))
        return origin_of(JobKind.CALIBRATE, given, "software")

    assert on("2026-03-01") == on("2026-04-01") != on("2026-04-02")


def test_a_file_without_content_answers_nothing(store, scanned, calibrate, compute):
    scan_id = scanned()
    first = calibrate(scan_id)
    compute()
    result_file(store, first.id).write_bytes(b"")
    assert states(calibrate(scan_id)) == [("queued", None)]


def test_an_inspection_keeps_its_answer_when_the_one_it_came_from_is_deleted(store, compute):
    def inspect():
        return store.inspections.accept_file(InspectionOptions(), store.files.receive([b"scan"], max_bytes=9))

    first = inspect()
    compute()
    second = inspect()
    store.inspections.delete(first.id)
    kept = store.inspections.get(second.id)
    assert (kept.answered_from, kept.result) == (first.id, second.result)
    assert store.files.upload(JobKind.INSPECT, second.id).is_file()
    assert states(inspect()) == [("succeeded", first.id)]


def test_many_at_once_are_all_answered_from_the_one_that_was_computed(store, scanned, calibrate, compute):
    scan_id = scanned()
    first = calibrate(scan_id)
    compute()
    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(lambda _: calibrate(scan_id), range(16)))
    assert states(*answers) == [("succeeded", first.id)] * 16
    assert len({answer.id for answer in answers}) == 16
    assert all(result_file(store, answer.id).read_text() == f"of {first.id}" for answer in answers)


@pytest.mark.parametrize("when", ["before its name", "before the commit"])
def test_killed_between_link_and_commit_nothing_half_written_stays(store, scanned, calibrate, compute, when):
    scan_id = scanned()
    first = calibrate(scan_id)
    compute()
    before = {path.name for path in (store.files.folder / "calibrations").iterdir()}
    child = os.fork()
    if not child:
        opened = Store(store.settings)
        publish = opened.files.publish

        def die(output, final):
            if when == "before the commit":
                publish(output, final)
            os._exit(KILLED)

        opened.files.publish = die
        opened.calibrations.accept(CalibrationAsk(scan_id=scan_id))
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == KILLED
    assert [item.id for item in store.calibrations.page().items] == [first.id]
    now_s = 0.0
    observer = Leftovers(store._database, store.files, grace_s=60.0, now_s=lambda: now_s)
    observer.remove_some()
    now_s = 120.0
    (left,) = observer.remove_some()
    assert left.parent.name == ("calibrations" if when == "before the commit" else "attempts")
    assert {path.name for path in (store.files.folder / "calibrations").iterdir()} == before
    assert result_file(store, first.id).read_text() == f"of {first.id}"
    assert states(calibrate(scan_id)) == [("succeeded", first.id)]
