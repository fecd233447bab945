import pytest

from sawmill_contracts import kinds
from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_contracts.phantoms import PhantomPicture, PhantomState
from sawmill_contracts.reconstructions import ReconstructionAsk
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec, ScanState
from sawmill_platform.contracts.jobs import Failure, FailureKind
from sawmill_platform.errors import Conflict
from sawmill_vocabulary import DataKind

REFUSAL = Failure(kind=FailureKind.INPUT, code="angles-missing", detail="the file carries no angles")


def test_a_scan_whose_reading_failed_is_refused_with_the_reason(store, upload):
    scan = upload(store)
    store.jobs.fail(store.jobs.claim("test"), REFUSAL)
    refused = store.scans.get(scan.id)
    assert (refused.state, refused.reason) == (ScanState.REFUSED, REFUSAL.detail)
    with pytest.raises(Conflict, match="was refused and cannot be used: the file carries no angles"):
        store.calibrations.accept(CalibrationAsk(scan_id=scan.id))


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


def test_a_picture_is_traced_by_a_job_and_a_calibration_waits_for_it(store, upload, finish):
    picture = PhantomPicture(name="cross", width_mm=400)
    phantom = store.phantoms.accept_picture(picture, store.files.receive([b"png"], max_bytes=10))
    assert phantom.state is PhantomState.TRACING
    assert store.files.upload(kinds.TRACE_PHANTOM, phantom.id).read_bytes() == b"png"
    assert store.phantoms.picture(phantom.id) == picture
    scan = upload(store, phantom_id=phantom.id)
    calibration = store.calibrations.accept(CalibrationAsk(scan_id=scan.id))
    done = [finish(store).job.subject_id for _ in range(3)]
    assert done == [phantom.id, scan.id, calibration.id]
    assert store.phantoms.get(phantom.id).drawing.name == "traced"
