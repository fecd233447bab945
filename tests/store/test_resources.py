import pytest

from sawmill_contracts import job_kinds
from sawmill_contracts.calibrations import CalibrationAsk, CalibrationSucceeded
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.history import HistoryKind
from sawmill_contracts.phantoms import PhantomDrawing, PhantomPicture, PhantomState
from sawmill_contracts.reconstructions import ReconstructionAsk
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec, ScanState
from sawmill_platform.contracts.jobs import Failure, FailureKind, JobState
from sawmill_platform.errors import Conflict, Invalid, NotFound
from sawmill_vocabulary import DataKind, Disc

REFUSAL = Failure(kind=FailureKind.INPUT, code="angles-missing", detail="the file carries no angles")


def everything_in(store, name: str) -> list[str]:
    return [path.name for path in (store.files.folder / name).rglob("*") if path.is_file()]


def test_a_scanner_reads_back_as_it_was_described(store, scanner):
    assert store.scanners.get(scanner.id) == scanner
    renamed = ScannerSpec.model_validate(
        scanner.model_dump(exclude={"id", "created_at", "active_calibration_id"}) | {"name": "Line 3"}
    )
    assert store.scanners.update(scanner.id, renamed).name == "Line 3"
    store.scanners.delete(scanner.id)
    with pytest.raises(NotFound, match=f"there is no scanner '{scanner.id}'"):
        store.scanners.get(scanner.id)


@pytest.mark.dialect
def test_an_id_is_given_once(store, scanner):
    with pytest.raises(Conflict, match="choose another id"):
        store.scanners.create(ScannerSpec(name="x", constants=scanner.constants), scanner_id=scanner.id)


@pytest.mark.dialect
def test_a_used_scanner_stays(store, scanner, upload):
    upload(store)
    with pytest.raises(Conflict, match="is used by 1 scans"):
        store.scanners.delete(scanner.id)


@pytest.mark.dialect
def test_a_list_is_read_newest_first_page_by_page(store):
    constants = ScannerConstants(source_to_cor_mm=859, num_detector_pixels=768, detector_pitch_mm=1.5)
    made = [store.scanners.create(ScannerSpec(name=f"Line {n}", constants=constants)).id for n in range(5)]
    seen, after = [], None
    for _ in range(3):
        page = store.scanners.page(after=after, limit=2)
        seen += [item.id for item in page.items]
        after = page.next
    assert seen == made[::-1]
    assert after is None


@pytest.mark.parametrize("cursor", ["x", "1e3.a", "9" * 40, ""])
def test_a_made_up_cursor_is_refused(store, cursor):
    with pytest.raises(Invalid, match="after must be the next of an earlier page"):
        store.scanners.page(after=cursor)


def test_an_accepted_scan_keeps_its_file_and_queues_its_reading(store, upload):
    scan = upload(store)
    assert scan.state is ScanState.INGESTING
    assert store.files.upload(job_kinds.INGEST, scan.id).read_bytes() == b"scan"
    job = store.jobs.get(scan.job_id)
    assert (job.kind, job.state, job.subject_id) == (job_kinds.INGEST, JobState.QUEUED, scan.id)
    assert everything_in(store, "incoming") == []


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [({"scanner_id": "nowhere"}, "no scanner 'nowhere'"), ({"phantom_id": "ghost"}, "no phantom 'ghost'")],
)
def test_a_scan_that_is_not_accepted_leaves_nothing(store, scanner, changes, sentence):
    spec = ScanSpec.model_validate({"scanner_id": scanner.id, "data": DataKind.COUNTS} | changes)
    received = store.files.receive([b"scan"], max_bytes=10)
    with pytest.raises(NotFound, match=sentence):
        store.scans.accept(spec, received)
    assert everything_in(store, "incoming") == everything_in(store, "uploads") == []
    assert store.jobs.page().items == []


@pytest.mark.dialect
def test_a_taken_scan_id_leaves_the_older_scan_s_file_alone(store, upload):
    upload(store, scan_id="mine")
    before = store.files.upload(job_kinds.INGEST, "mine").stat()
    with pytest.raises(Conflict, match="there is a scan 'mine' already"):
        upload(store, scan_id="mine")
    assert store.files.upload(job_kinds.INGEST, "mine").stat() == before
    assert everything_in(store, "incoming") == []


def test_a_read_scan_reports_what_was_found(ready_scan):
    assert ready_scan.state is ScanState.READY
    assert ready_scan.shape.views == 20
    assert ready_scan.remarks == ["one invalid frame left out"]


def test_a_scan_whose_reading_failed_is_refused_with_the_reason(store, upload):
    scan = upload(store)
    store.jobs.fail(store.jobs.claim("test"), REFUSAL)
    refused = store.scans.get(scan.id)
    assert (refused.state, refused.reason) == (ScanState.REFUSED, REFUSAL.detail)
    with pytest.raises(Conflict, match="was refused and cannot be used: the file carries no angles"):
        store.calibrations.accept(CalibrationAsk(scan_id=scan.id))


def test_scans_are_filtered_by_scanner_and_state(store, ready_scan, upload):
    waiting = upload(store)
    assert [scan.id for scan in store.scans.page(state=ScanState.READY).items] == [ready_scan.id]
    assert [scan.id for scan in store.scans.page(scanner_id=waiting.scanner_id).items] == [waiting.id, ready_scan.id]
    assert store.scans.page(scanner_id="other").items == []


def test_a_scan_in_use_stays_and_an_unused_one_goes_with_its_files(store, ready_scan):
    calibration = store.calibrations.accept(CalibrationAsk(scan_id=ready_scan.id))
    with pytest.raises(Conflict, match=f"needed by job '{calibration.job_id}'"):
        store.scans.delete(ready_scan.id)
    store.jobs.request_cancel(calibration.job_id)
    store.scans.delete(ready_scan.id)
    assert everything_in(store, "uploads") == everything_in(store, "scans") == []
    assert store.calibrations.get(calibration.id).scan_id == ready_scan.id


def test_a_calibration_takes_the_scan_s_phantom_and_its_state_is_its_job_s(store, ready_scan, finish):
    asked = store.calibrations.accept(CalibrationAsk(scan_id=ready_scan.id, seed=11))
    assert (asked.phantom_id, asked.state, asked.options.seed) == ("l-shape", "queued", 11)
    finish(store)
    done = store.calibrations.get(asked.id)
    assert isinstance(done, CalibrationSucceeded)
    assert done.verdict == "pass"
    assert store.calibrations.page(state=JobState.SUCCEEDED).items == [done]
    assert store.calibrations.page(state=JobState.QUEUED).items == []


def test_a_scan_without_a_phantom_needs_one_in_the_ask(store, upload):
    scan = upload(store, phantom_id=None)
    with pytest.raises(Conflict, match="names no phantom: name the one it shows, as phantom_id"):
        store.calibrations.accept(CalibrationAsk(scan_id=scan.id))
    assert store.calibrations.accept(CalibrationAsk(scan_id=scan.id, phantom_id="l-shape")).phantom_id == "l-shape"


@pytest.mark.parametrize(
    ("verdicts", "active"), [(("watch", "pass"), True), (("watch", None), False), (("pass", None), True)]
)
def test_a_calibration_activates_itself_by_the_verdict_on_its_rays(
    store, scanner, ready_scan, finish, verdicts, active
):
    """None: an attempt of an earlier version, which has the verdict alone."""
    asked = store.calibrations.accept(CalibrationAsk(scan_id=ready_scan.id, activate=True))
    finish(store, verdict=verdicts[0], rays_verdict=verdicts[1])
    assert (store.scanners.get(scanner.id).active_calibration_id == asked.id) is active


def test_a_technician_may_go_back_to_an_older_calibration(store, scanner, ready_scan, finish):
    calibrations = []
    for _ in range(2):
        calibrations.append(store.calibrations.accept(CalibrationAsk(scan_id=ready_scan.id)).id)
        with pytest.raises(Conflict, match="is queued; only one that succeeded"):
            store.calibrations.activate(calibrations[-1], "too early")
        finish(store)
        store.calibrations.activate(calibrations[-1], "accepted")
    assert store.calibrations.activate(calibrations[0], "rolled back").active_calibration_id == calibrations[0]
    history = store.history.page(scanner.id, kind=HistoryKind.ACTIVATION).items
    assert [(entry.subject_id, entry.why) for entry in history] == [
        (calibrations[0], "rolled back"),
        (calibrations[1], "accepted"),
        (calibrations[0], "accepted"),
    ]


def test_a_reconstruction_takes_the_active_calibration(store, ready_scan, finish):
    ask = ReconstructionAsk(scan_id=ready_scan.id)
    with pytest.raises(Conflict, match="has no active calibration: name one as calibration_id, or give theta"):
        store.reconstructions.accept(ask)
    calibration = store.calibrations.accept(CalibrationAsk(scan_id=ready_scan.id, activate=True))
    finish(store)
    asked = store.reconstructions.accept(ask)
    assert asked.calibration_id == asked.options.calibration_id == calibration.id
    finish(store)
    done = store.reconstructions.get(asked.id)
    assert (done.state, done.result.unit) == ("succeeded", "1/mm")


def test_a_calibration_without_result_or_of_another_scanner_reconstructs_nothing(store, scanner, ready_scan):
    cancelled = store.calibrations.accept(CalibrationAsk(scan_id=ready_scan.id))
    store.jobs.request_cancel(cancelled.job_id)
    with pytest.raises(Conflict, match="was cancelled and has no geometry to use"):
        store.reconstructions.accept(ReconstructionAsk(scan_id=ready_scan.id, calibration_id=cancelled.id))
    calibration = store.calibrations.accept(CalibrationAsk(scan_id=ready_scan.id))
    other = store.scanners.create(ScannerSpec(name="Line 3", constants=scanner.constants))
    spec = ScanSpec(scanner_id=other.id, data=DataKind.COUNTS)
    scan = store.scans.accept(spec, store.files.receive([b"scan"], max_bytes=10))
    with pytest.raises(Conflict, match=f"is of scanner '{scanner.id}', but scan"):
        store.reconstructions.accept(ReconstructionAsk(scan_id=scan.id, calibration_id=calibration.id))


def test_the_built_in_phantoms_are_there_and_stay(store):
    built_in = {phantom.id for phantom in store.phantoms.page().items if phantom.built_in}
    assert built_in == {"l-shape", "rectangle-with-hole"}
    with pytest.raises(Conflict, match="is built in and stays"):
        store.phantoms.delete("l-shape")


def test_a_drawn_phantom_is_ready_at_once_and_stays_while_used(store, upload):
    drawing = PhantomDrawing(name="disc", shapes=[Disc(center_mm=(0, 0), radius_mm=50)])
    phantom = store.phantoms.create(drawing)
    assert (phantom.state, phantom.drawing) == (PhantomState.READY, drawing)
    upload(store, phantom_id=phantom.id)
    with pytest.raises(Conflict, match="is used by scans"):
        store.phantoms.delete(phantom.id)
    spare = store.phantoms.create(drawing, phantom_id="spare")
    store.phantoms.delete(spare.id)
    with pytest.raises(NotFound):
        store.phantoms.get("spare")


def test_a_picture_is_traced_by_a_job_and_a_calibration_waits_for_it(store, upload, finish):
    picture = PhantomPicture(name="cross", width_mm=400)
    phantom = store.phantoms.accept_picture(picture, store.files.receive([b"png"], max_bytes=10))
    assert phantom.state is PhantomState.TRACING
    assert store.files.upload(job_kinds.TRACE_PHANTOM, phantom.id).read_bytes() == b"png"
    assert store.phantoms.picture(phantom.id) == picture
    scan = upload(store, phantom_id=phantom.id)
    calibration = store.calibrations.accept(CalibrationAsk(scan_id=scan.id))
    done = [finish(store).job.subject_id for _ in range(3)]
    assert done == [phantom.id, scan.id, calibration.id]
    assert store.phantoms.get(phantom.id).drawing.name == "traced"


def test_a_refused_picture_reports_why(store):
    picture = PhantomPicture(name="cross", width_mm=400)
    phantom = store.phantoms.accept_picture(picture, store.files.receive([b"png"], max_bytes=10))
    store.jobs.fail(store.jobs.claim("test"), REFUSAL)
    refused = store.phantoms.get(phantom.id)
    assert (refused.state, refused.reason) == (PhantomState.REFUSED, REFUSAL.detail)
    store.phantoms.delete(phantom.id)
    assert everything_in(store, "uploads") == []
