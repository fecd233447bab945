"""What the process of an attempt has and reaches, whatever the job, in real processes over tasks without science."""

import json
import os
from pathlib import Path

import pytest
from missing_parts import skip_without
from results import RESULTS, THETA, answer_of
from tiers import both_ways

from sawmill_contracts import kinds
from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_contracts.drifts import DriftAsk
from sawmill_contracts.geometry import GivenTheta, ScannerConstants
from sawmill_contracts.inspections import InspectionOptions
from sawmill_contracts.phantoms import BUILT_IN_PHANTOMS, PhantomPicture
from sawmill_contracts.plans import PlanAsk
from sawmill_contracts.reconstructions import ReconstructionAsk
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.attempts.limits import OPEN_FILES, limits_of, processor_s
from sawmill_platform.confinement import landlock
from sawmill_platform.contracts.jobs import JobKind, JobState
from sawmill_store.mill_files import SCAN_FILE
from sawmill_vocabulary import DataKind

pytestmark = pytest.mark.slow


@pytest.fixture
def finish(store):
    """Do the oldest job without a process."""

    def do():
        claim = store.jobs.claim("test")
        output = store.files.make_attempt_folder(claim.job_id, claim.attempt)
        (output / SCAN_FILE).touch()
        store.jobs.succeed(claim, answer_of(claim.job.kind, RESULTS[claim.job.kind]()), output)

    return do


@pytest.fixture
def one_of_each(store, finish):
    """A waiting job of every kind, all of which tell what they have and reach."""
    store.phantoms.seed_built_in(BUILT_IN_PHANTOMS)
    constants = ScannerConstants(source_to_cor_mm=859.46, num_detector_pixels=768, detector_pitch_mm=1.5)
    scanner = store.scanners.create(ScannerSpec(name="tell-all", constants=constants)).id
    spec = ScanSpec(scanner_id=scanner, data=DataKind.COUNTS, phantom_id="l-shape")

    def upload():
        return store.files.receive([b"tell-all"], max_bytes=100)

    scan = store.scans.accept(spec, upload()).id
    finish()
    calibration = store.calibrations.accept(CalibrationAsk(scan_id=scan, activate=True)).id
    finish()
    store.scans.accept(spec, upload(), scan_id="mine")
    store.phantoms.accept_picture(PhantomPicture(name="ell", width_mm=400), upload())
    store.calibrations.accept(CalibrationAsk(scan_id=scan))
    store.reconstructions.accept(ReconstructionAsk(scan_id=scan, calibration_id=calibration))
    store.plans.accept(PlanAsk(scanner_id=scanner, theta=GivenTheta(**THETA)), given={"phantom_id": "l-shape"})
    store.drifts.accept(DriftAsk(scan_id=scan, calibration_id=calibration))
    store.inspections.accept_file(InspectionOptions(), upload(), name="tell-all")


@pytest.fixture
def reported(store, start, settings, one_of_each, monkeypatch):  # noqa: ARG001 - waiting jobs
    """By kind, what the attempts reported, with secrets all around; afresh, of the first two kinds."""
    for path in (store.files.folder.parent / "canary", store.files.upload(kinds.INGEST, "other")):
        path.parent.mkdir(exist_ok=True)
        path.write_text("canary")
    monkeypatch.setenv("SAWMILL_TOKEN", "canary")
    monkeypatch.setenv("SAWMILL_DATABASE_URL", "postgresql://sawmill:canary@127.0.0.1/sawmill")
    monkeypatch.setenv("PGPASSWORD", "canary")
    runner = start(memory_limit_bytes=None, broker_url="redis://:canary@127.0.0.1/0")
    started = JobKind.all() if settings.fork_attempts else JobKind.all()[:2]
    assert [runner.run_next() for _ in started] == [JobState.FAILED] * len(started)
    jobs = {kind: store.jobs.page(kind=kind, limit=1).items[0] for kind in started}
    assert {job.failure.code for job in jobs.values()} == {"reported"}
    return {kind: json.loads(job.failure.detail) for kind, job in jobs.items()}


@both_ways
def test_every_kind_of_attempt_has_limits_a_folder_and_its_own_files_alone(store, reported):
    if landlock.version() == 0:
        skip_without("the kernel has no Landlock")
    attempts = store.files.folder / "attempts"
    for kind, each in reported.items():
        least = limits_of(kind, memory_bytes=0, file_bytes=0, memory_limit_bytes=None)
        assert each["limits"]["DATA"] == least.data_bytes, kind
        assert processor_s(kind) <= each["limits"]["CPU"] <= processor_s(kind) + 60, kind
        assert each["limits"]["FSIZE"] == least.file_bytes, kind
        assert (each["limits"]["NOFILE"], each["limits"]["CORE"]) == (OPEN_FILES, 0), kind
        assert {line.split()[1] for line in each["capabilities"]} == {"0" * 16}, kind
        folder = Path(each["folder"])
        assert (folder.parents[1], folder.name, each["in folder"]) == (attempts, "work", []), kind
        assert (Path(each["scratch"]).parent, Path(each["home"])) == (folder, folder), kind
        assert "canary" not in "".join(each["environment"]), kind
        # Beside the log: pipes from and to its worker, and what the kernel tells of cores and memory.
        assert not [path for path in each["open"] if not path.startswith(("pipe:", "/proc/"))], kind
        done = {name: ending for name, ending in each["tries"].items() if ending != "PermissionError"}
        assert done == {}, kind
    assert list(attempts.iterdir()) == []
    assert (store.files.folder.parent / "canary").read_text() == "canary"


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, who alone can give a folder away")
def test_a_folder_that_root_reaches_by_its_capabilities_alone_is_an_outage(store, runner, queue):
    job = queue("succeed")
    store.files.folder.chmod(0o700)
    os.chown(store.files.folder, 1000, 1000)
    assert runner.run_next() is JobState.QUEUED
    waiting = store.jobs.get(job.id)
    assert (waiting.waiting_for.code, waiting.losses) == ("storage-unavailable", 0)
    assert "run the service as the user that the data folder belongs to" in waiting.waiting_for.detail
    os.chown(store.files.folder, 0, 0)
    assert runner.run_next() is JobState.SUCCEEDED
