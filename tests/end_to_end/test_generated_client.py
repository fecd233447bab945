"""The generated client is the contract's, and the programs of docs/rest.md do the whole job with it and with curl."""

import os
import re
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from sawmill_service.cli import main

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/rest.md"
COMMITTED = ROOT / "openapi/clients/python"
DOCUMENTED = "http://127.0.0.1:8000"
SIMULATED = ("log-with-phantom", "--theta", "146.1deg,714.7,319.9,43.7,15.7deg", "--views", "90", "--rows", "4")
# Operations that answer a file and that the page does without; the rest comes from the page's own program.
OTHER_FILES = """
from sawmill_calibration_client.api.calibrations import get_log_after, get_log_before
from sawmill_calibration_client.api.keys import get_audit_file
from sawmill_calibration_client.api.phantoms import get_drawing, get_phantom
from sawmill_calibration_client.api.reconstructions import get_mosaic, get_side_array, get_side_view
from sawmill_calibration_client.api.scans import get_sinogram

assert get_side_array.sync(slices.id, client=api).payload.read(6) == b"\\x93NUMPY"
assert b"</svg>" in get_drawing.sync(phantom.id, client=api).payload.read()
for picture in (
    *(ask.sync(calibration.id, client=api) for ask in (get_log_after, get_log_before)),
    *(ask.sync(slices.id, client=api) for ask in (get_mosaic, get_side_view)),
    get_sinogram.sync(scan.id, client=api),
):
    assert picture.payload.read(4) == b"\\x89PNG"
assert get_audit_file.sync(client=api).code == "scope-too-small"
finished(traced.job_id)
assert answered(get_phantom.sync(traced.id, client=api)).state == "ready"
"""


def blocks(page: Path, language: str) -> str:
    return "\n".join(re.findall(rf"^```{language}\n(.*?)^```$", page.read_text(), flags=re.MULTILINE | re.DOTALL))


@pytest.fixture(scope="module")
def client_folder(tmp_path_factory):
    """The client as the contract of now makes it."""
    folder = tmp_path_factory.mktemp("generated") / "python"
    generator = ROOT / "openapi/clients/generate.py"
    done = subprocess.run([sys.executable, generator, folder], capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"the generator leaves out a part of the contract:\n{done.stdout}{done.stderr}"
    return folder


def files_of(folder: Path) -> dict[str, bytes]:
    """What git would hold of a client: what an installation leaves in its folder is none of it."""
    left = {"__pycache__", "build", "sawmill_calibration_client.egg-info"}
    paths = [path for path in folder.rglob("*") if path.is_file() and not left & {*path.relative_to(folder).parts}]
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def test_the_committed_client_is_that_of_the_contract(client_folder):
    committed, generated = files_of(COMMITTED), files_of(client_folder)
    names = committed.keys() | generated.keys()
    different = sorted(name for name in names if committed.get(name) != generated.get(name))
    assert not different, (
        "openapi/clients/python is not what openapi/openapi.json leads to: run `make clients`, read what it changes as "
        f"a program of somebody else meets it, and commit it with the contract. Different: {different[:20]}"
    )


def run(command: list[str], folder: Path, **environment: str) -> str:
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    variables = {**os.environ, "PATH": path, "no_proxy": "*", **environment}
    done = subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    return done.stdout


def check_files(folder: Path) -> None:
    for name in ("report.png", "overlay.png", "slice.png"):
        with Image.open(folder / name) as picture:
            assert picture.size >= (256, 256), name
    assert (np.load(folder / "slice.npy").shape, np.load(folder / "slice.npy").dtype) == ((256, 256), np.float32)
    with h5py.File(folder / "volume.h5") as file:
        assert file["entry/reconstruction/data"].shape == (1, 256, 256)
    with h5py.File(folder / "calibration.h5") as file:
        assert len(file) > 0


@pytest.mark.timeout(180)
def test_the_page_s_programs_do_the_whole_job(tmp_path, embedded, client_folder):
    simulated = CliRunner().invoke(main, ["simulate", *SIMULATED, "--phantom-rows", "3", "-o", f"{tmp_path}/mill.h5"])
    assert simulated.exit_code == 0, simulated.output
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    (tmp_path / "python").mkdir()
    address = str(embedded.client.base_url)
    shell = blocks(PAGE, "sh").replace(DOCUMENTED, address)
    printed = run(["bash", "-euo", "pipefail", "-c", shell], tmp_path)
    for name in ("mill.h5", "phantom.png"):
        (tmp_path / "python" / name).symlink_to(tmp_path / name)
    program = "\n".join((blocks(PAGE, "python"), OTHER_FILES, blocks(client_folder / "README.md", "python")))
    key = embedded.post("/v1/keys", json={"name": "program", "scope": "activate"})["secret"]
    variables = {"SAWMILL_KEY": key, "PYTHONPATH": str(client_folder)}
    said = run([sys.executable, "-c", program.replace(DOCUMENTED, address)], tmp_path / "python", **variables)
    for folder in (tmp_path, tmp_path / "python"):
        check_files(folder)
    assert "pass\n" in printed
    assert all("nothing moved that this scan can show" in each for each in (printed, said))
    assert "there is no scan 'no-such-scan'" in printed
    assert '"code":"scan-not-found"' in (tmp_path / "problem.json").read_text()
    assert said.startswith("pass 3")
    assert "404 scan-not-found there is no scan 'no-such-scan'" in said
    sent = 2 * (tmp_path / "mill.h5").stat().st_size + (tmp_path / "mean.npy").stat().st_size
    assert f"{sent} bytes in scans" in said  # the stack once whole, once in parts; its log's mean
