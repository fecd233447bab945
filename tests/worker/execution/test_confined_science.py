"""Every kind of job with its science, in the product's own processes: what they open late they may open."""

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from small_scanner import CONSTANTS, SCANNER, THETA

from sawmill_command.seeding import RECORDED, RECORDED_LOG, RECORDED_PAIRS
from sawmill_contracts import fixed_pairs, pair_logs
from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.drifts import DriftRequest
from sawmill_contracts.inspections import InspectionOptions
from sawmill_contracts.phantoms import BUILT_IN_PHANTOMS, PhantomPicture
from sawmill_contracts.plans import PlanRequest
from sawmill_contracts.reconstructions import ReconstructionRequest
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.contracts.jobs import JobKind, JobState
from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.projection.analytic import DetectorCells, project
from sawmill_vocabulary import DataKind, ReconstructionMethod
from sawmill_worker.program import ATTEMPT_COMMAND

pytestmark = pytest.mark.slow
VIEWS = 120


def stack_of_an_l() -> bytes:
    angles = (np.arange(VIEWS) + 0.5) * TAU / VIEWS
    fan = FanBeamGeometry(SCANNER, THETA, angles)
    sinogram = project(L_SHAPE, DetectorCells.of(SCANNER), fan.frame, angles)
    buffer = io.BytesIO()
    np.save(buffer, sinogram[:, None].astype(np.float32))
    return buffer.getvalue()


@pytest.fixture
def asked(store):
    store.phantoms.seed_built_in(BUILT_IN_PHANTOMS)
    scanner = store.scanners.create(ScannerSpec(name="Line 2", constants=CONSTANTS)).id
    spec = ScanSpec(scanner_id=scanner, data=DataKind.LINE_INTEGRALS, angles_deg="1.5:3", phantom_id="l-shape")
    scan = store.scans.accept(spec, store.files.receive([stack_of_an_l()], max_bytes=10**7)).id
    picture = PhantomPicture(name="ell", width_mm=400)
    buffer = io.BytesIO()
    Image.fromarray(np.rint(255 * L_SHAPE.rasterise(400, 400.0)).astype(np.uint8)).save(buffer, format="PNG")
    store.phantoms.accept_picture(picture, store.files.receive([buffer.getvalue()], max_bytes=10**7))
    store.inspections.accept_file(InspectionOptions(), store.files.receive([stack_of_an_l()], max_bytes=10**7))
    for identifier, name in {**RECORDED_PAIRS, **RECORDED_LOG}.items():
        received = store.files.receive([(RECORDED / name).read_bytes()], max_bytes=10**7)
        store.inspections.accept_file(InspectionOptions(), received, identifier=identifier)
    for declared, name in ((fixed_pairs.DECLARATION, "pairs"), (pair_logs.DECLARATION, "log")):
        ask = declared.ask.model_validate(declared.to_ask.example["body"])
        store.asked(declared).accept(ask, identifier=f"example-{name}")
    calibration = store.calibrations.accept(CalibrationRequest(scan_id=scan, activate=True)).id
    store.plans.accept(PlanRequest(scanner_id=scanner, theta=THETA, views=VIEWS), given={"phantom_id": "l-shape"})
    for method in ReconstructionMethod:
        store.reconstructions.accept(ReconstructionRequest(scan_id=scan, theta=THETA, size=32, method=method))
    store.drifts.accept(DriftRequest(scan_id=scan, calibration_id=calibration))


@pytest.mark.usefixtures("asked", "own_templates")
def test_every_kind_of_job_does_its_work_with_its_own_files_alone(store, settings, start, attempts, capfd):
    unhurried = {"memory_limit_bytes": None, "start_timeout_s": 250}
    runner = start(starter=attempts(settings.model_copy(update=unhurried), ATTEMPT_COMMAND), **unhurried)
    while runner.run_next() is not None:
        pass
    jobs = store.jobs.page(limit=50).items
    assert {job.kind for job in jobs} == set(JobKind.all()), "ask for one of each kind in `asked`"
    assert {job.kind: job.failure for job in jobs if job.state is not JobState.SUCCEEDED} == {}
    log = "".join(capfd.readouterr())
    assert "Permission" not in log
    assert "kernel-not-kept" not in log
    assert list((store.files.folder / "attempts").iterdir()) == []
    assert not list(Path(store.files.folder).glob("*/*/work"))
