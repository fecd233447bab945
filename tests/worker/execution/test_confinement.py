"""What the process of an attempt has and reaches, whatever the job, in real processes over tasks without science."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from missing_parts import both_ways, skip_without
from results import SCANNER_SPEC, THETA, succeed
from structlog.testing import capture_logs

from sawmill_contracts import fixed_pairs, kinds, pair_logs
from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.drifts import DriftRequest
from sawmill_contracts.geometry import GivenTheta
from sawmill_contracts.inspections import InspectionOptions
from sawmill_contracts.phantoms import BUILT_IN_PHANTOMS, PhantomPicture
from sawmill_contracts.plans import PlanRequest
from sawmill_contracts.reconstructions import ReconstructionRequest
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.attempts.limits import OPEN_FILES, limits_of, processor_s
from sawmill_platform.confinement import landlock
from sawmill_platform.confinement.confinement import say_if_unconfined
from sawmill_platform.contracts.jobs import JobKind, JobState
from sawmill_platform.workers.settings import ExecutionSettings
from sawmill_store.mill_files import SCAN_FILE
from sawmill_vocabulary import DataKind

pytestmark = pytest.mark.slow


@pytest.fixture
def reported(store, start, settings, monkeypatch):
    """By kind, what the attempts reported, with secrets all around; afresh, of the first two kinds."""
    store.phantoms.seed_built_in(BUILT_IN_PHANTOMS)
    scanner = store.scanners.create(ScannerSpec.model_validate(SCANNER_SPEC | {"name": "tell-all"})).id
    spec = ScanSpec(scanner_id=scanner, data=DataKind.COUNTS, phantom_id="l-shape")

    def upload():
        return store.files.receive([b"tell-all"], max_bytes=100)

    scan = store.scans.accept(spec, upload()).id
    succeed(store, write=lambda output: (output / SCAN_FILE).touch())
    calibration = store.calibrations.accept(CalibrationRequest(scan_id=scan, activate=True)).id
    succeed(store)
    store.scans.accept(spec, upload(), scan_id="mine")
    store.phantoms.accept_picture(PhantomPicture(name="ell", width_mm=400), upload())
    store.calibrations.accept(CalibrationRequest(scan_id=scan))
    store.reconstructions.accept(ReconstructionRequest(scan_id=scan, calibration_id=calibration))
    store.plans.accept(PlanRequest(scanner_id=scanner, theta=GivenTheta(**THETA)), given={"phantom_id": "l-shape"})
    store.drifts.accept(DriftRequest(scan_id=scan, calibration_id=calibration))
    inspection = store.inspections.accept_file(InspectionOptions(), upload(), name="tell-all").id
    for declared, name in ((fixed_pairs.DECLARATION, "pairs"), (pair_logs.DECLARATION, "log")):
        ask = declared.to_ask.example["body"] | {"inspection_ids": [inspection] * 2}
        store.asked(declared).accept(declared.ask.model_validate(ask), identifier=f"example-{name}")
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
        assert {name: ending for name, ending in each["tries"].items() if ending != "PermissionError"} == {}, kind
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


WITHOUT_LANDLOCK = """
import ctypes, errno, struct, sys
from pathlib import Path

# Linux's own answer to a call that it lacks, by a filter of system calls (<linux/seccomp.h>) for those of Landlock.
LOAD, AT_LEAST, ABOVE, RETURN = 0x20, 0x35, 0x25, 0x06
lines = [(LOAD, 0, 0, 0), (AT_LEAST, 0, 2, 444), (ABOVE, 1, 0, 446), (RETURN, 0, 0, 0x50000 | errno.ENOSYS)]
lines.append((RETURN, 0, 0, 0x7FFF0000))
program = b"".join(struct.pack("=HBBI", *line) for line in lines)

class Program(ctypes.Structure):
    _fields_ = (("length", ctypes.c_ushort), ("instructions", ctypes.c_char_p))

libc = ctypes.CDLL(None)
assert libc.prctl(38, 1, 0, 0, 0) == 0
if libc.prctl(22, 2, ctypes.byref(Program(len(lines), program))):
    raise SystemExit("this kernel has no seccomp")

from sawmill_platform.confinement import landlock
from sawmill_platform.confinement.confinement import confine_to
from sawmill_platform.contracts.attempts import AttemptInput

assert landlock.version() == 0
folder = Path(sys.argv[1])
confine_to(AttemptInput(kept=folder), folder)
(folder / "result").touch()
"""


def test_rights_that_a_kernel_does_not_know_are_not_asked_for():
    # <linux/landlock.h>: REFER came with version 2, TRUNCATE with 3, TCP with 4, IOCTL_DEV with 5, the scopes with 6.
    known = [landlock.handled_by(version) for version in range(1, 8)]
    assert [each.file_rights.bit_length() for each in known] == [13, 14, 15, 15, 16, 16, 16]
    assert [each.tcp_rights for each in known] == [0, 0, 0, 3, 3, 3, 3]
    assert [each.scopes for each in known] == [0, 0, 0, 0, 0, 3, 3]


@pytest.mark.parametrize(
    ("version", "wanted", "user", "lines"),
    [
        (0, True, 1000, ["attempts-not-confined"]),
        (3, True, 1000, ["attempts-confined-in-part"]),
        (6, True, 1000, []),
        (6, True, 0, ["run-as-root"]),
        (7, False, 1000, ["attempts-not-confined"]),
    ],
)
def test_what_the_kernel_lacks_and_root_are_said_once_at_the_start(version, wanted, user, lines):
    with capture_logs() as log:
        say_if_unconfined(ExecutionSettings(confine_attempts=wanted), user, version)
    assert [line["event"] for line in log] == lines


def test_a_kernel_without_landlock_lets_jobs_run(tmp_path):
    tmp_path.chmod(0o777)
    subprocess.run([sys.executable, "-c", WITHOUT_LANDLOCK, str(tmp_path)], check=True, timeout=60)
    assert (tmp_path / "result").exists()


CONFINED = """
import sys
from contextlib import suppress
from pathlib import Path
from sawmill_platform.confinement.landlock import confine

readable, held, writable = (Path(sys.argv[1]) / name for name in ("readable", "held", "writable"))
confine([readable], [writable], held=[held])
for folder in (readable, held):
    assert (folder / "file").read_text() == "as it was"
    for change in (lambda file: file.write_text("changed"), Path.unlink, lambda file: file.with_name("more").touch()):
        with suppress(PermissionError):
            change(folder / "file")
(writable / "file").write_text("changed")
"""


@pytest.mark.skipif(landlock.version() == 0, reason="the kernel has no Landlock")
def test_what_may_be_read_may_not_be_changed(tmp_path):
    for name in ("readable", "held", "writable"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").write_text("as it was")
    subprocess.run([sys.executable, "-c", CONFINED, str(tmp_path)], check=True, timeout=60)
    texts = {str(path.relative_to(tmp_path)): path.read_text() for path in tmp_path.rglob("*") if path.is_file()}
    assert texts == {"readable/file": "as it was", "held/file": "as it was", "writable/file": "changed"}
