"""The `sawmill` command as a shell runs it; in this process what no shell can change."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from live_service import wait_until
from tests.support.exact_chords import Detector, counted, scan

from sawmill_formats.output.scan_writer import new_scan
from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_vocabulary import DetectorModule, SourceFrame
from sawmill_vocabulary.version import VERSION

pytestmark = pytest.mark.slow

SAWMILL = Path(sys.executable).with_name("sawmill")
THETA = "2.55,714.7,319.9,43.7,0.281"


def sawmill(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([SAWMILL, *map(str, arguments)], capture_output=True, text=True, timeout=120, check=False)


def test_an_early_interruption_is_no_traceback():
    program = (
        "import sys\n"
        "class Interrupt:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'sawmill_command.cli': raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Interrupt())\n"
        "from sawmill_command.entry import main; main()"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stderr) == (130, "")


def test_the_version_is_that_of_the_code_and_help_names_every_command(run):
    assert sawmill("--version").stdout.strip() == VERSION
    commands = ("serve", "demo", "calibrate", "reconstruct", "simulate", "export", "worker", "openapi")
    assert all(f" {command} " in run("--help").stdout for command in commands)


def test_standard_output_is_the_object_alone(run, phantom_scan):
    flags = ("--data", "line-integrals", "--source-to-cor-mm", 859.46, "--phantom", "l-shape", "--json")
    done = sawmill("calibrate", phantom_scan, *flags)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("\n") == 1
    assert json.loads(done.stdout)["state"] == "succeeded"
    refused = run("calibrate", phantom_scan, *flags, "--rows", "7:9", code=1)
    assert json.loads(refused.stdout)["failure"]["code"] == "rows-outside"
    assert "rows-outside" in refused.stderr
    run("calibrate", phantom_scan, *flags, "--rows", "9:7", code=2)


def test_a_command_that_is_terminated_leaves_nothing_behind(stack, tmp_path):
    # Many pixels: far from done when the volume is begun.
    flags = ("--data", "counts", "--source-to-cor-mm", 859.46, "--theta", THETA, "--method", "cauchy_map")
    command = ("reconstruct", stack, *flags, "--size", 768, "-o", tmp_path / "out.h5")
    with subprocess.Popen([SAWMILL, *map(str, command)]) as process:
        wait_until(lambda: any(tmp_path.glob(".out.h5.*.part")))
        # The volume that is begun and the prepared scan.
        assert len(list(tmp_path.iterdir())) == 2
        process.terminate()
    assert process.returncode == 143
    assert list(tmp_path.iterdir()) == []


def test_openapi_writes_the_document_and_a_request_for_each_operation(run, tmp_path):
    run("openapi", "--folder", tmp_path)
    document = json.loads((tmp_path / "openapi.json").read_text())
    operations = [operation for item in document["paths"].values() for operation in item.values()]
    assert document["openapi"].startswith("3.1")
    assert len(list((tmp_path / "requests").glob("*.json"))) == len(operations)


def test_a_service_that_cannot_keep_its_data_does_not_start(tmp_path):
    (tmp_path / "data").touch()
    done = sawmill("serve", "--data", tmp_path / "data", "--port", 0)
    assert done.returncode == 1
    assert done.stderr.startswith("The service cannot start: ")


def test_a_worker_s_scanners_are_known(tmp_path):
    Store.open(StorageSettings(data_folder=tmp_path, database_url=None)).close()
    done = sawmill("worker", "--data", tmp_path, "--scanners", "Line 9")
    assert done.returncode == 1
    assert "there is no scanner of the id or name 'Line 9'" in done.stderr


@pytest.mark.parametrize("command", ["serve", "worker"])
@pytest.mark.parametrize(
    ("name", "value", "complaint"),
    [
        ("SAWMILL_LEASE_S", "soon", "SAWMILL_LEASE_S"),
        ("SAWMILL_LEASE", "30", "SAWMILL_LEASE is no setting: did you mean SAWMILL_LEASE_S?"),
    ],
)
def test_a_setting_that_is_wrong_or_misspelt_is_wrong_use(run, command, tmp_path, monkeypatch, name, value, complaint):
    monkeypatch.setenv("SAWMILL_DATA_FOLDER", "")  # the command sets it
    monkeypatch.setenv(name, value)
    assert complaint in run(command, "--data", tmp_path / "data", code=2).stderr
    assert not (tmp_path / "data").exists()


FRAME = SourceFrame(0.3, 917.1, 1619.3, -109.1, -0.083)
MODULES = (DetectorModule(128, 4.0),)
GIVEN = ("--data", "line-integrals", "--angles-deg", "0:8")
VIEWS = 45


@pytest.fixture(scope="module")
def calibrated(run, tmp_path_factory):
    """The scan, in three rows of counts, and the answer of its calibration."""
    folder = tmp_path_factory.mktemp("modules")
    wood = [replace(shape, density=0.008) for shape in L_SHAPE.shapes]
    shown = scan(wood, Detector(256, 4.5, MODULES), FRAME, np.deg2rad(8.0 * np.arange(VIEWS)))
    stack = np.stack([counted(shown, seed=row) for row in range(3)], axis=1).astype(np.float32)
    np.save(folder / "scan.npy", stack)
    pitch = ("--source-to-cor-mm", 859.46, "--detector-pitch-mm", 4.5)
    answer = run("calibrate", folder / "scan.npy", *GIVEN, *pitch, "--phantom", "l-shape", "--json").stdout
    (folder / "answer.json").write_text(answer, encoding="utf-8")
    return folder, json.loads(answer)


def test_the_answer_says_where_the_modules_meet(calibrated):
    _, answer = calibrated
    (module,) = answer["scanner"]["detector_modules"]
    assert module["first_cell"] == 128
    # Three rows of 45 views determine the gap to 0.04 mm.
    assert module["gap_mm"] == pytest.approx(4.0, abs=0.15)
    assert answer["rays_verdict"] in {"pass", "watch"}, "cells of 4.5 mm leave a bound near the tolerance"
    assert any("modules meet at cell 128" in sentence for sentence in answer["adjustments"])


def test_a_volume_is_made_along_the_modules_and_says_so(calibrated, run, tmp_path):
    folder, answer = calibrated
    flags = ("--calibration", folder / "answer.json", "--size", 64, "--method", "fbp", "-o", tmp_path / "volume.h5")
    run("reconstruct", folder / "scan.npy", *GIVEN, *flags)
    with h5py.File(tmp_path / "volume.h5") as file:
        stated = json.loads(file["entry/geometry/detector_modules"][()])
    assert stated == answer["scanner"]["detector_modules"]


def test_no_toolkit_is_told_of_a_straight_detector(calibrated, run, tmp_path):
    folder, _ = calibrated
    flags = ("--calibration", folder / "answer.json", "--angles-deg", "0:8", "--views", VIEWS)
    refused = run("export", "--to", "astra", *flags, "-o", tmp_path / "vectors.txt", code=1)
    assert "only the form vectors holds modules and arcs" in refused.stderr
    assert not (tmp_path / "vectors.txt").exists()


def test_modules_that_the_file_states_are_known_from_the_start(calibrated, run, tmp_path):
    folder, answer = calibrated
    stack, path = np.load(folder / "scan.npy"), tmp_path / "scan.nxs"
    about = {"angles_rad": np.deg2rad(8.0 * np.arange(VIEWS)), "detector_pitch_mm": 4.5, "row_pitch_mm": None}
    with new_scan(path, stack.shape, **about, detector_modules=MODULES) as written:
        written.data[...] = stack
        written.note(air_level=None, provenance={})
    assert "2, which meet at cell 128" in run("inspect", path, "--data", "line-integrals").stdout
    flags = ("--data", "line-integrals", "--source-to-cor-mm", 859.46, "--phantom", "l-shape")
    known = json.loads(run("calibrate", path, *flags, "--json").stdout)
    assert not any("modules" in sentence for sentence in known["adjustments"])
    (module,) = known["scanner"]["detector_modules"]
    assert module["gap_mm"] == pytest.approx(4.0, abs=0.15)
    assert known["predicted_ray_error_mm"]["upper_95"] <= answer["predicted_ray_error_mm"]["upper_95"]
