"""The `sawmill` command as a shell runs it; in this process what no shell can change."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from live_service import wait_until

from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store
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
