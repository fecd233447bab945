"""What an ask needs, what a phantom's measurements make of it, and how long an inspected file is kept."""

import pytest

from sawmill_contracts import kinds
from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.drifts import DriftRequest
from sawmill_contracts.inspections import FILE_KEPT, InspectionOptions
from sawmill_contracts.phantoms import MeasurementsRequest, PhantomDrawing, PhantomPicture, SizeMeasurement
from sawmill_contracts.plans import PlanRequest
from sawmill_contracts.reconstructions import ReconstructionRequest
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec, ScanState
from sawmill_platform.errors import Conflict
from sawmill_vocabulary import STANDARD_SIZE_TOLERANCE, DataKind, Disc, Polygon, Theta

pytestmark = pytest.mark.clocked

NOMINAL = Theta(2.55, 714.7, 319.9, 43.7, 0.281)
BUILT_IN = {"phantom_id": "l-shape"}


def refused(sentence):
    return pytest.raises(Conflict, match=sentence)


@pytest.fixture
def traced(store):
    return store.phantoms.accept_picture(
        PhantomPicture(name="cross", width_mm=400.0), store.files.receive([b"png"], max_bytes=10)
    )


def test_what_was_refused_is_of_no_use_and_gives_its_reason(store, scanner, upload, refuse, traced):
    with refused("is tracing and has no drawing to measure"):
        store.phantoms.measure(traced.id, MeasurementsRequest(measurements=[length("x", 20.0)]))
    refuse("the file carries no angles")
    with refused("cannot be used: the file carries no angles"):
        store.plans.accept(PlanRequest(scanner_id=scanner.id, theta=NOMINAL), given={"phantom_id": traced.id})
    scan = upload(store)
    refuse("the file carries no angles")
    seen = store.scans.get(scan.id)
    assert (seen.state, seen.reason) == (ScanState.REFUSED, "the file carries no angles")
    with refused("was refused and cannot be used: the file carries no angles"):
        store.calibrations.accept(CalibrationRequest(scan_id=scan.id))


def test_an_ask_names_what_neither_its_scan_nor_its_scanner_has(store, scanner, upload, ready_scan, finish):
    with refused(r"has no active calibration: name one as calibration_id$"):
        store.drifts.accept(DriftRequest(scan_id=ready_scan.id))
    with refused("has no active calibration whose theta could be taken: give theta"):
        store.plans.accept(PlanRequest(scanner_id=scanner.id), given=BUILT_IN)
    calibration = store.calibrations.accept(CalibrationRequest(scan_id=ready_scan.id, activate=True))
    finish(store)
    asked = store.plans.accept(PlanRequest(scanner_id=scanner.id), given=BUILT_IN)
    assert asked.options.theta == store.calibrations.get(calibration.id).theta
    bare = upload(store, phantom_id=None)
    with refused("names no phantom: name the one it shows, as phantom_id"):
        store.calibrations.accept(CalibrationRequest(scan_id=bare.id))
    assert store.calibrations.accept(CalibrationRequest(scan_id=bare.id, phantom_id="l-shape")).phantom_id == "l-shape"


def test_a_calibration_without_result_or_of_another_scanner_is_of_no_use(store, scanner, ready_scan):
    cancelled, calibration = (store.calibrations.accept(CalibrationRequest(scan_id=ready_scan.id)) for _ in range(2))
    store.jobs.request_cancel(cancelled.job_id)
    with refused("was cancelled and has no geometry to use"):
        store.reconstructions.accept(ReconstructionRequest(scan_id=ready_scan.id, calibration_id=cancelled.id))
    other = store.scanners.create(ScannerSpec(name="Line 3", constants=scanner.constants))
    spec = ScanSpec(scanner_id=other.id, data=DataKind.COUNTS)
    scan = store.scans.accept(spec, store.files.receive([b"scan"], max_bytes=10))
    for kind, ask in ((store.reconstructions, ReconstructionRequest), (store.drifts, DriftRequest)):
        with refused(f"is of scanner '{scanner.id}', but scan"):
            kind.accept(ask(scan_id=scan.id, calibration_id=calibration.id))


def test_a_job_waits_for_the_phantom_the_scan_and_the_calibration_that_it_needs(store, upload, finish, traced):
    scan = upload(store, phantom_id=traced.id)
    calibration = store.calibrations.accept(CalibrationRequest(scan_id=scan.id))
    drift = store.drifts.accept(DriftRequest(scan_id=scan.id, calibration_id=calibration.id))
    subjects = []
    for needs in (True, True, True, False):
        assert (drift.job_id not in store.jobs.queued_job_ids()) is needs
        subjects.append(finish(store).job.subject_id)
    assert subjects == [traced.id, scan.id, calibration.id, drift.id]
    assert store.phantoms.get(traced.id).drawing.name == "traced"


@pytest.mark.parametrize(
    ("verdicts", "active"), [(("watch", "pass"), True), (("watch", None), False), (("pass", None), True)]
)
def test_a_calibration_activates_itself_by_the_verdict_on_its_rays(
    store, scanner, ready_scan, finish, verdicts, active
):
    """None: an attempt of an earlier version, which has the verdict alone."""
    asked = store.calibrations.accept(CalibrationRequest(scan_id=ready_scan.id, activate=True))
    finish(store, verdict=verdicts[0], rays_verdict=verdicts[1])
    assert (store.scanners.get(scanner.id).active_calibration_id == asked.id) is active


BOARD = Polygon(((-100.0, -150.0), (100.0, -150.0), (100.0, 150.0), (-100.0, 150.0)))
HOLE = Disc((-50.0, 0.0), 20.0, -1.0)


def length(what: str, measured_mm: float, **others: object) -> SizeMeasurement:
    return SizeMeasurement(dimension=what, measured_mm=measured_mm, standard_uncertainty_mm=0.1, **others)


def rms(first: float, second: float) -> float:
    return ((first**2 + second**2) / 2) ** 0.5


@pytest.fixture
def board(store):
    drawing = PhantomDrawing(name="board", shapes=[BOARD, HOLE], measurements=[length("diagonal", 360.0)])
    return store.phantoms.create(drawing)


def test_the_shapes_are_stretched_to_what_was_measured_and_the_old_phantom_stays(store, board):
    newer = store.phantoms.measure(board.id, MeasurementsRequest(measurements=[length("x", 198.0), length("y", 303.0)]))
    assert newer.drawing.extent_mm == pytest.approx((198.0, 303.0))
    disc = newer.drawing.shapes[1]
    assert disc.center_mm == pytest.approx((-49.5, 0.0))
    # The geometric mean of 0.99 and 1.01, to the tenth of a micrometre at which shapes are kept.
    assert disc.radius_mm == pytest.approx(20.0 * (0.99 * 1.01) ** 0.5, abs=1e-4)
    assert newer.drawing.follows == board.id
    assert (store.phantoms.get(board.id), store.phantoms.followers()) == (board, {board.id: newer.id})


def test_a_length_replaces_the_earlier_one_of_its_name_and_the_size_tolerance_follows(store, board):
    first = store.phantoms.measure(
        board.id, MeasurementsRequest(measurements=[length("x", 199.0)], stretch_drawing=False)
    )
    again = store.phantoms.measure(first.id, MeasurementsRequest(measurements=[length("x", 199.5)]))
    measured = [(each.dimension, each.measured_mm) for each in again.drawing.measurements]
    assert measured == [("diagonal", 360.0), ("x", 199.5)]
    assert first.drawing.extent_mm == (200.0, 300.0)
    assert again.drawing.extent_mm == pytest.approx((199.5, 300.0))
    # The RMS over both sides: y is as it was drawn, and the drawing states no tolerance of its own.
    assert again.drawing.size_tolerance == pytest.approx(rms(STANDARD_SIZE_TOLERANCE, 0.1 / 199.5))
    both = store.phantoms.measure(again.id, MeasurementsRequest(measurements=[length("y", 300.0)]))
    assert both.drawing.size_tolerance == pytest.approx(
        (((0.1 / 360) ** 2 + (0.1 / 199.5) ** 2 + (0.1 / 300) ** 2) / 3) ** 0.5
    )


def test_a_side_not_measured_keeps_the_tolerance_of_its_drawing_and_the_true_axis_alone_is_enough(store):
    first = store.phantoms.create(PhantomDrawing(name="board", shapes=[BOARD], size_tolerance=0.004))
    for measured_mm in (199.0, 199.5, 200.0):
        first = store.phantoms.measure(first.id, MeasurementsRequest(measurements=[length("x", measured_mm)]))
        assert first.drawing.size_tolerance == pytest.approx(rms(0.004, 0.1 / measured_mm))
    board = store.phantoms.create(PhantomDrawing(name="board", shapes=[BOARD], true_axis="x"))
    newer = store.phantoms.measure(board.id, MeasurementsRequest(measurements=[length("x", 200.0)]))
    assert newer.drawing.size_tolerance == pytest.approx(0.1 / 200)


GRACE_S = 3600.0


def looked(store):
    """What goes at two looks, a grace apart."""
    now_s = 0.0
    observer = store.leftovers(grace_s=GRACE_S, now_s=lambda: now_s)
    observer.remove_some()
    now_s = 2.0 * GRACE_S
    return observer.remove_some()


def inspect(store):
    return store.inspections.accept_file(InspectionOptions(), store.files.receive([b"scan"], max_bytes=10))


def test_a_file_stays_until_it_has_been_inspected(store, clock, finish):
    inspected = inspect(store)
    clock.advance(days=3)
    assert looked(store) == []
    finish(store)
    assert looked(store) == [store.files.upload(kinds.INSPECT, inspected.id).parent]


def test_a_file_goes_a_day_after_it_came_and_its_answer_and_its_scan_stay(store, clock, finish, scanner):
    inspected = inspect(store)
    finish(store)
    assert inspected.file_kept_until == clock.now + FILE_KEPT
    spec = ScanSpec(scanner_id=scanner.id, data=DataKind.COUNTS)
    scan = store.scans.accept(spec, store.inspections.received_again(inspected.id))
    clock.advance(seconds=FILE_KEPT.total_seconds() - 1.0)
    assert looked(store) == []
    clock.advance(seconds=2.0)
    assert looked(store) == [store.files.upload(kinds.INSPECT, inspected.id).parent]
    assert store.inspections.get(inspected.id).result.verdict == "incomplete"
    assert store.files.upload(kinds.INGEST, scan.id).read_bytes() == b"scan"
