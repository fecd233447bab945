"""What jobs may need, by the sizes that were recorded when their scans were read."""

import pytest

from sawmill_contracts import kinds
from sawmill_contracts.geometry import GivenTheta
from sawmill_contracts.phantoms import BUILT_IN_PHANTOMS, PhantomPicture
from sawmill_contracts.plans import PlanAsk
from sawmill_contracts.scans import ScanReading, ScanShape, ScanSpec
from sawmill_platform.attempts.limits import DATA_BYTES
from sawmill_vocabulary import DataKind
from sawmill_worker.jobs.running import needs_of

THETA = GivenTheta(
    initial_angle_rad=2.55, detector_to_cor_mm=714.7, source_shift_mm=319.9, detector_shift_mm=43.7, detector_tilt=0.281
)
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
    store.phantoms.accept_picture(
        PhantomPicture(name="ell", width_mm=400), store.files.receive([b"unread"], max_bytes=10)
    )
    store.scans.accept(
        ScanSpec(scanner_id=scan.scanner_id, data=DataKind.COUNTS), store.files.receive([b"8 TB"], max_bytes=10)
    )
    assert needs_of(attempt(kinds.INGEST)).memory_bytes == 0
    assert needs_of(attempt(kinds.TRACE_PHANTOM)).memory_bytes == 0


def test_a_calibration_needs_all_rows_that_it_averages(scan, calibrating):
    assert needs_of(calibrating(scan)).memory_bytes > max(2 * STACK, DATA_BYTES)
    assert needs_of(calibrating(scan, rows="0:16")).memory_bytes < DATA_BYTES


def test_a_reconstruction_needs_its_blocks_its_images_and_its_volume(scan, reconstructing):
    def needs(**options):
        return needs_of(reconstructing(scan, theta=THETA, **options))

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
    store.plans.accept(PlanAsk(scanner_id=scan.scanner_id, theta=THETA, views=3600), given={"phantom_id": "l-shape"})
    assert 3600 * CELLS * 8 < needs_of(attempt(kinds.PLAN)).memory_bytes < 2 * DATA_BYTES
