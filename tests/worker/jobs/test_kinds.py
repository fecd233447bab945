"""Each kind of job: its module, the codes of its failures, its needs; plans and inspections."""

import ast
import io
from importlib import import_module
from inspect import signature
from pathlib import Path

import h5py
import numpy as np
import pytest
import results
from PIL import Image

from sawmill_calibration.scans.inspect import NO_SCAN
from sawmill_contracts import kinds
from sawmill_contracts.failure_codes import CODES, OTHER, counted_as
from sawmill_contracts.geometry import GivenTheta
from sawmill_contracts.inspections import PICTURE_PX, InspectionOptions, InspectionResult, ScanPicture
from sawmill_contracts.kinds import Reference
from sawmill_contracts.phantoms import BUILT_IN_PHANTOMS, PhantomDrawing, PhantomPicture
from sawmill_contracts.plans import PlanRequest, PlanResult
from sawmill_contracts.scans import ScanReading, ScanShape, ScanSpec
from sawmill_platform.attempts.limits import DATA_BYTES
from sawmill_platform.attempts.protocol import Needs
from sawmill_platform.contracts.attempts import JobFailure
from sawmill_platform.contracts.jobs import FailureKind, JobKind
from sawmill_platform.errors import DamagedResult, StorageFull, StorageUnavailable
from sawmill_tomography.calibration.planning import plan
from sawmill_tomography.geometry.geometry import FanBeamGeometry
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_vocabulary import DataKind, Disc
from sawmill_worker.jobs.running import needs_of, run


@pytest.mark.parametrize("kind", JobKind.all())
def test_a_kind_s_module_has_its_function_and_its_needs(kind):
    module = import_module(f"sawmill_worker.jobs.{kind.replace('-', '_')}")
    assert list(signature(module.run).parameters) == ["attempt"]
    assert signature(module.needs).return_annotation is Needs


WORKER = Path(__file__).parents[3] / "worker"
ROOMS = (
    "sawmill_platform/attempts",
    "sawmill_platform/confinement",
    "sawmill_platform/jobs",
    "sawmill_formats",
    "sawmill_tomography",
    "sawmill_worker/jobs",
    "sawmill_calibration",
)
# Where the code stands among the arguments.
RAISED = {"refused": 0, "UnreadableScan": 0, "CalibrationError": 0, "DriftError": 0, "JobFailure": 1}


def codes_in(path: Path) -> set[str]:
    """Literals that stand where a code does, those between which an expression chooses included."""
    found = set()
    for call in ast.walk(ast.parse(path.read_text())):
        if isinstance(call, ast.Call):
            name = getattr(call.func, "id", None)
            given = call.args[RAISED[name] :][:1] if name in RAISED else []
            given += [keyword.value for keyword in call.keywords if keyword.arg == "code"]
            literals = (part for code in given for part in ast.walk(code))
            found |= {part.value for part in literals if isinstance(part, ast.Constant) and isinstance(part.value, str)}
    return found


def test_the_list_has_the_codes_of_the_sources():
    paths = [path for room in ROOMS for path in (WORKER / room).rglob("*.py")]
    found = {code for path in paths for code in codes_in(path)}
    assert len(found) > 50  # else the search finds nothing
    # What a job works on may have been deleted before it is handed over (`sawmill_store/subjects/mill_subjects.py`).
    gone = {f"{kind}-deleted" for kind in Reference if kind is not Reference.THETA}
    no_scans = {code for code, _ in NO_SCAN.values()}
    raised = found | {StorageFull.code, StorageUnavailable.code, DamagedResult.code} | gone | no_scans
    assert not raised - CODES, "add these to sawmill_contracts/failure_codes.py"
    assert not CODES - raised, "no job fails with these: take them out of sawmill_contracts/failure_codes.py"


def test_a_code_that_is_not_in_the_list_counts_as_another():
    assert counted_as("worker-lost") == "worker-lost"
    assert counted_as("<invented>") == counted_as(None) == OTHER


KNOWN_THETA = GivenTheta(**results.THETA)
VIEWS, ROWS, CELLS = 360, 2500, 768
STACK = 4 * VIEWS * ROWS * CELLS


@pytest.fixture
def scan(store, spec, attempt, finish):
    """A whole log, as recorded: its file is looked at by nobody here."""
    store.phantoms.seed_built_in(BUILT_IN_PHANTOMS)
    asked = ScanSpec(scanner_id=store.scanners.create(spec()).id, data=DataKind.COUNTS, phantom_id="l-shape")
    accepted = store.scans.accept(asked, store.files.receive([b"unread"], max_bytes=10))
    shape = ScanShape(views=VIEWS, rows=ROWS, detector=CELLS)
    reading = ScanReading(format="npy", shape=shape, angular_range_deg=(0.0, 359.0))
    finish(attempt(kinds.INGEST), reading.model_dump(mode="json"))
    return accepted


def test_what_reads_a_file_has_no_needs_of_memory(store, scan, attempt):
    unread = [store.files.receive([b"8 TB"], max_bytes=10) for _ in range(2)]
    store.phantoms.accept_picture(PhantomPicture(name="ell", width_mm=400), unread[0])
    store.scans.accept(ScanSpec(scanner_id=scan.scanner_id, data=DataKind.COUNTS), unread[1])
    assert needs_of(attempt(kinds.INGEST)).memory_bytes == 0
    assert needs_of(attempt(kinds.TRACE_PHANTOM)).memory_bytes == 0


def test_a_calibration_needs_all_rows_that_it_averages(scan, calibrating):
    assert needs_of(calibrating(scan)).memory_bytes > max(2 * STACK, DATA_BYTES)
    assert needs_of(calibrating(scan, rows="0:16")).memory_bytes < DATA_BYTES


def test_a_reconstruction_needs_its_blocks_its_images_and_its_volume(scan, reconstructing):
    def needs(**options):
        return needs_of(reconstructing(scan, theta=KNOWN_THETA, **options))

    usual = needs(method="fbp")
    # Half of what is free is for the blocks, which take 0.8 GB.
    assert 2 * 805_000_000 < usual.memory_bytes <= DATA_BYTES
    assert 4 * ROWS * 256**2 < usual.file_bytes < 2**31
    large = needs(method="fbp", size=2048)
    assert large.file_bytes > 4 * ROWS * 2048**2
    assert large.memory_bytes < STACK
    # Thirty-two slices iterate together, each with two dozen images, and forty times its data.
    assert needs(method="total_variation", size=1024, rows="0:16").memory_bytes > 2 * 32 * 24 * 4 * 1024**2
    assert needs(method="total_variation", size=32).memory_bytes > 2 * 32 * 40 * 4 * VIEWS * CELLS


def test_a_plan_needs_its_sinogram(store, scan, attempt):
    store.plans.accept(
        PlanRequest(scanner_id=scan.scanner_id, theta=KNOWN_THETA, views=3600), given={"phantom_id": "l-shape"}
    )
    assert 3600 * CELLS * 8 < needs_of(attempt(kinds.PLAN)).memory_bytes < 2 * DATA_BYTES


@pytest.fixture
def asked(store, spec, theta):
    store.scanners.create(spec(), scanner_id="line-2")
    ask = PlanRequest(scanner_id="line-2", theta=theta, views=30, noise=0.01)
    return lambda phantom_id: store.plans.accept(ask, given={"phantom_id": phantom_id})


def test_a_plan_answers_with_the_precision_to_expect(asked, attempt, finish, store, scanner, theta, turn):
    accepted = asked("l-shape")
    planning = attempt(kinds.PLAN)
    answer = run(planning)
    result = PlanResult.model_validate(answer)
    expected = plan(FanBeamGeometry(scanner, theta, turn(30)), L_SHAPE, noise=0.01)
    assert result.predicted_ray_error_mm.rms == expected.predicted_ray_error.rms_mm
    assert result.standard_deviation.source_frame.magnification == expected.frame_deviation[5]
    assert result.standard_deviation.theta.source_shift_mm == expected.theta_deviation[2]
    assert list(planning.output.iterdir()) == []
    finish(planning, answer)
    assert store.plans.get(accepted.id).result == result


def test_a_phantom_that_cannot_calibrate_is_the_asker_s_to_mend(asked, attempt, store):
    asked(store.phantoms.create(PhantomDrawing(name="disc", shapes=[Disc(center_mm=(0, 0), radius_mm=50)])).id)
    with pytest.raises(JobFailure, match="looks the same from every side") as failure:
        run(attempt(kinds.PLAN))
    assert (failure.value.kind, failure.value.code) == (FailureKind.INPUT, "phantom")


COUNTS = np.random.default_rng(7).integers(1000, 30_000, (12, 1, 8)).astype(np.uint16)


def inspecting(store, attempt, content, **options):
    received = store.files.receive([content], max_bytes=10**7)
    store.inspections.accept_file(InspectionOptions(**options), received, name="morning.npz")
    return attempt(kinds.INSPECT)


def inspected(store, attempt, content, **options):
    return InspectionResult.model_validate(run(inspecting(store, attempt, content, **options)))


def npz(**arrays):
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def needed(result):
    return [part.field for part in result.missing if part.needed]


def test_what_neither_the_file_carries_nor_was_given_is_named_by_its_field(store, attempt):
    content = npz(projections=COUNTS, flats=COUNTS[:2])
    result = inspected(store, attempt, content)
    assert (result.file, result.verdict) == ("morning.npz", "incomplete")
    assert (result.reading.shape.views, result.reading.flats, result.reading.angles) == (12, 2, None)
    assert needed(result) == ["angles_deg", "data", "detector_pitch_mm"]
    result = inspected(store, attempt, content, data=DataKind.COUNTS, angles_deg="0.5:30")
    assert (result.reading.angles.first_deg, result.reading.angles.last_deg) == pytest.approx((0.5, 330.5))
    assert needed(result) == ["detector_pitch_mm"]


def test_a_wrong_angle_is_one_sentence_and_what_is_no_scan_is_refused_without_a_flag(store, attempt):
    with pytest.raises(JobFailure, match="an angle must be a number of degrees, not 'abc'"):
        inspected(store, attempt, npz(projections=COUNTS), angles_deg="abc")
    buffer = io.BytesIO()
    Image.fromarray(np.zeros((8, 8), np.uint8)).save(buffer, format="PNG")
    refused = [inspected(store, attempt, content) for content in (buffer.getvalue(), b"a letter to the editor" * 100)]
    assert [result.verdict for result in refused] == ["refused", "refused"]
    assert not any("--" in result.refusal.detail for result in refused)


@pytest.mark.parametrize(("rows", "name"), [(1, ScanPicture.SINOGRAM), (4, ScanPicture.VIEW)])
def test_one_view_of_a_stack_or_the_sinogram_of_a_row_is_drawn(store, attempt, rows, name):
    counts = np.repeat(np.arange(96).reshape(12, 1, 8), rows, axis=1)
    inspection = inspecting(store, attempt, npz(projections=counts, flats=counts[:2]))
    run(inspection)
    drawn = np.fromfile(inspection.output / name, np.uint8).reshape(PICTURE_PX, PICTURE_PX)
    assert (drawn[0, 0], drawn[0, -1] < drawn[-1, -1]) == (0, rows == 1)  # all views, or the first one alone


def test_numbers_that_cannot_be_read_refuse_the_file_at_once(store, attempt):
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        packed = {"chunks": (1, 4, 8), "compression": "gzip"}
        chunk = file.create_dataset("entry/data/data", data=np.repeat(COUNTS, 4, axis=1), **packed).id.get_chunk_info(0)
    content = bytearray(buffer.getvalue())
    content[chunk.byte_offset : chunk.byte_offset + chunk.size] = bytes(chunk.size)
    result = inspected(store, attempt, bytes(content), dataset="/entry/data/data")
    assert result.verdict == "refused", result
