"""The direction of imports (docs/understand/architecture.md#direction-of-imports), and what each part wakes up."""

import ast
import os
import subprocess
import sys
from collections import defaultdict
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import numpy as np
import pytest

from sawmill_platform.attempts.importing import PROGRAM, UNUSED
from sawmill_tomography.geometry.geometry import Scanner, Theta
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_vocabulary.version import PACKAGES

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
WORKER = ROOT / "worker"


@cache
def imported_by(statements: str) -> frozenset[str]:
    script = f"import sys\n{statements}\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return frozenset(done.stdout.splitlines()[-1].split())


def imports_of(path: Path) -> set[str]:
    """Every module that a file imports, also in functions and for types alone, and every name in it."""
    nodes = list(ast.walk(ast.parse(path.read_text("utf-8"))))
    plain = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    froms = [node for node in nodes if isinstance(node, ast.ImportFrom) and node.module]
    return plain | {
        name for node in froms for alias in node.names for name in (node.module, f"{node.module}.{alias.name}")
    }


@cache
def imports_between_files() -> dict[str, set[str]]:
    """The files of all packages by their import names, with the files that each imports."""
    roots = [ROOT / "worker", ROOT / "service"]
    paths = [(path, path.relative_to(root)) for root in roots for path in root.rglob("*.py")]
    files = {".".join(name.with_suffix("").parts).removesuffix(".__init__"): path for path, name in paths}
    return {name: (imports_of(path) & {*files}) - {name, name.rpartition(".")[0]} for name, path in files.items()}


def test_files_import_each_other_in_no_circle():
    assert list(TopologicalSorter(imports_between_files()).static_order())  # raises for a circle


WITHOUT_CIRCLES = ("sawmill_tomography.", "sawmill_calibration.", "sawmill_store.")


def test_folders_of_the_science_the_library_and_the_store_import_each_other_in_no_circle():
    """A folder and the folders in it are no circle: each is compared with those beside it."""
    imports: dict[tuple[str, ...], set[tuple[str, ...]]] = defaultdict(set)
    for name, imported in imports_between_files().items():
        here = tuple(name.split("."))[:-1]
        for there in (tuple(other.split("."))[:-1] for other in imported if name.startswith(WITHOUT_CIRCLES)):
            for depth in range(2, min(len(here), len(there)) + 1):
                if here[: depth - 1] == there[: depth - 1] and here[:depth] != there[:depth]:
                    imports[here[:depth]].add(there[:depth])
    assert list(TopologicalSorter(imports).static_order())  # raises for a circle


def of(packages: tuple[str, ...], modules: frozenset[str]) -> set[str]:
    return {name for name in modules if any(name == package or name.startswith(f"{package}.") for package in packages)}


BELOW_PICTURES = (
    *("sawmill_calibration.pictures.templating", "sawmill_mill", "sawmill_contracts", "sawmill_platform.contracts"),
    "sawmill_vocabulary",
)


@pytest.mark.parametrize(
    ("package", "allowed", "never"),
    [
        ("sawmill_tomography", ("sawmill_vocabulary",), ("pydantic", "sqlalchemy", "fastapi", "h5py")),
        ("sawmill_contracts", ("sawmill_platform.contracts", "sawmill_vocabulary"), ("numpy", "sqlalchemy")),
        ("sawmill_formats", ("sawmill_platform", "sawmill_vocabulary"), ("sqlalchemy", "fastapi")),
        ("sawmill_platform.contracts", ("sawmill_vocabulary",), ("sqlalchemy", "numpy", "fastapi")),
        ("sawmill_calibration.pictures", BELOW_PICTURES, ("sqlalchemy", "fastapi", "h5py")),
    ],
)
def test_a_package_stands_on_those_below_it_alone(package, allowed, never):
    # Every module of a package, by its import name and with commas between.
    paths = sorted((WORKER / package.replace(".", "/")).rglob("*.py"))
    names = (".".join(path.relative_to(WORKER).with_suffix("").parts) for path in paths)
    modules = imported_by(f"import {', '.join(name.removesuffix('.__init__') for name in names)}")
    roots = {each.split(".")[0] for each in (package, *allowed)}  # whose own __init__.py imports nothing
    assert not of(PACKAGES, modules) - roots - of((package, *allowed), modules)
    assert not of(never, modules)


# Packages in whose processes a library that crashes or loops stops more than one job.
SERVING = ("service/sawmill_service", "worker/sawmill_store", "worker/sawmill_mill", "worker/sawmill_platform")
# What names a result without comparing its digest, and who may: senders of files, and what never opens one.
UNVERIFIED = {
    "sawmill_platform/files/file_store.py": {"results", "unverified"},
    "sawmill_platform/jobs/job_store.py": {"results"},
    "sawmill_service/pages/calibrate/calibrate.py": {"results"},
    "sawmill_service/routes/calibrations.py": {"unverified"},
    "sawmill_service/routes/reconstructions.py": {"unverified"},
    "sawmill_store/scans/phantoms.py": {"results"},
    "sawmill_store/retention/retention_store.py": {"results"},
    "sawmill_store/scans/scans.py": {"results"},
    "sawmill_store/subjects/mill_subjects.py": {"results"},
}


def test_results_are_opened_through_one_door():
    """A path of a result comes from `FileStore.result`, which compares the digest, and only readers open it."""
    named, opened = {}, []
    for path in (path for package in SERVING for path in (ROOT / package).rglob("*.py")):
        module, tree = str(path.relative_to(ROOT)).partition("/")[2], ast.parse(path.read_text())
        calls = {node.func.attr for node in ast.walk(tree) if isinstance(node, ast.Call) and hasattr(node.func, "attr")}
        if calls & {"results", "unverified"}:
            named[module] = calls & {"results", "unverified"}
        imported = {
            name
            for node in ast.walk(tree)
            if isinstance(node, ast.Import | ast.ImportFrom)
            for name in (getattr(node, "module", ""), *(alias.name for alias in node.names))
        }
        if imported & {"h5py", "sawmill_formats.hdf5", "open_hdf5", "own_hdf5", "sawmill_formats.output.own_hdf5"}:
            opened.append(module)
    assert opened == []
    assert named == UNVERIFIED


NUMERICAL = ("numpy", "scipy", "numba", "h5py", "PIL", "skimage", "matplotlib", "tifffile")
SERVER = ("sqlalchemy", "celery", "fastapi", "uvicorn")
# Numba imports SciPy's linear algebra when it loads its first kernel.
OF_SCIPY = ("linalg", "version", "_lib", "__config__", "_cyutility", "_distributor_init")
SCIPY_OF_NUMBA = {f"scipy.{name}" for name in OF_SCIPY}


def started_by(*line: str) -> frozenset[str]:
    """Every module that a fresh interpreter holds after a line of `sawmill`."""
    run = f"sys.argv = {['sawmill', *line]}\ntry: main()\nexcept SystemExit as end: assert not end.code"
    return imported_by(f"from sawmill_command.entry import main\n{run}")


@pytest.mark.parametrize("question", ["--version", "--help"])
def test_the_version_and_the_list_of_commands_wait_for_no_library(question):
    modules = started_by(question)
    assert not of((*NUMERICAL, *SERVER, "pydantic", "sawmill_contracts"), modules)
    assert ("rich" in modules) == (question == "--help")


@pytest.mark.parametrize("command", ["calibrate", "drift", "reconstruct", "serve"])
def test_the_help_of_a_command_waits_for_nothing_that_only_its_work_needs(command):
    assert not of((*NUMERICAL, *SERVER, "sawmill_tomography", "sawmill_formats.input"), started_by(command, "--help"))


def test_a_calibration_waits_for_nothing_that_only_other_work_needs(tmp_path):
    frame = Theta(2.55, 714.7, 319.9, 43.7, 0.281).source_frame(859.46)
    angles = np.radians(np.arange(0.5, 360.0, 3.0))
    sinogram = analytic.project(L_SHAPE, DetectorCells.of(Scanner(859.46, 256, 4.5)), frame, angles)
    path = tmp_path / "scan.npy"
    np.save(path, sinogram + np.random.default_rng(1).normal(0.0, 0.01 * sinogram.std(), sinogram.shape))
    flags = "--data line-integrals --angles-deg 0.5:3 --source-to-cor-mm 859.46 --detector-pitch-mm 4.5 --json"
    modules = started_by("calibrate", str(path), *flags.split(), "--phantom", "l-shape")
    assert "sawmill_tomography.calibration.judgement" in modules
    assert not of((*SERVER, "rich", "PIL", "skimage", "matplotlib", "tifffile"), modules)
    assert {name for name in modules if name.startswith("scipy.") and name.count(".") == 1} <= SCIPY_OF_NUMBA
    other_contracts = {f"sawmill_contracts.{name}" for name in ("drifts", "reconstructions", "inspections")}
    assert not of(("sawmill_calibration.pictures", "sawmill_worker.jobs", "sawmill_store", *other_contracts), modules)


def test_a_process_that_is_kept_ready_has_all_jobs_imported_and_no_library_that_none_needs():
    modules = imported_by("import sawmill_worker.attempt")
    jobs = ("ingest", "calibrate", "reconstruct", "trace_phantom", "plan", "drift")
    assert {f"sawmill_worker.jobs.{job}" for job in jobs} <= modules
    assert {"scipy.fft", "scipy.ndimage", "scipy.sparse", "scipy.special", "tifffile"} <= modules
    never = {"scipy.stats", "scipy.optimize", "scipy.interpolate", "matplotlib", "alembic", "celery", "sqlalchemy"}
    assert not modules & never


@pytest.mark.parametrize("resting", ["sawmill_command.commands, sawmill_service.serving", "sawmill_worker.poller"])
def test_what_runs_idle_holds_no_library_that_only_work_needs(resting):
    """The memory of a service at rest (`make bench-job-price`)."""
    loaded = imported_by(f"import {resting}")
    assert not loaded & {"numpy", "scipy", "numba", "h5py", "PIL", "matplotlib", "alembic", "celery"}
    if "sawmill_service" in resting:
        assert "sawmill_service.app" in loaded
        science = ("sawmill_tomography", "sawmill_formats.input", "sawmill_worker.jobs", "sawmill_calibration")
        pictures = {"sawmill_calibration"} | of(("sawmill_calibration.pictures",), loaded)
        assert not of(("numba", "scipy", "skimage", "matplotlib", *science), loaded) - pictures


def test_a_worker_and_its_template_hold_no_library_that_others_bring_along(tmp_path):
    """As they are started: `structlog` would import one, Numba and NumPy the others."""
    started = "import sys, sawmill_worker.attempt, sawmill_worker.poller\n"
    tells = "def main():\n    print(*(name for name, module in sys.modules.items() if module is not None))\n"
    (tmp_path / "program.py").write_text(started + tells)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    done = subprocess.run([*PROGRAM, "program"], capture_output=True, text=True, check=True, env=environment)
    loaded = set(done.stdout.split())
    assert {"structlog", "numba", "sqlalchemy"} <= loaded
    assert not loaded & {*UNUSED}
