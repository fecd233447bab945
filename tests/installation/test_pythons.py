"""The wheel on each declared Python, with the one constraints file: the same theta, to the last digit."""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import bundle
import pytest

ROOT = Path(__file__).parents[2]
CLASSIFIERS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["classifiers"]
DECLARED = re.findall(r"Python :: (3\.\d+)", "\n".join(CLASSIFIERS))
SCAN = ("simulate", "l-shape", "--theta", "146.1deg,714.7,319.9,43.7,15.7deg", "--views", "20", "--noise", "0.02")


def interpreter(version: str) -> str | None:
    """A Python of this version: on the path, or one that pyenv has."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"), "versions")
    candidates = [shutil.which(f"python{version}"), *sorted(pyenv.glob(f"{version}.*/bin/python{version}"))]
    for candidate in filter(None, candidates):
        asked = [str(candidate), "-c", "import ensurepip, sys; print('%d.%d' % sys.version_info[:2])"]
        found = subprocess.run(asked, capture_output=True, text=True, check=False)
        if (found.returncode, found.stdout.strip()) == (0, version):
            return str(candidate)
    return None


def run(*command: object, folder: Path) -> str:
    """The standard output of a command, in an environment without this one's packages."""
    clean = {name: value for name, value in os.environ.items() if name not in {"PYTHONPATH", "VIRTUAL_ENV"}}
    words = [str(part) for part in command]
    done = subprocess.run(words, cwd=folder, env=clean, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    bundle.export(ROOT, folder / "sources")
    build = ("-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder)
    run(sys.executable, *build, folder / "sources", folder=folder)
    (made,) = folder.glob("*.whl")
    return made


@pytest.fixture(scope="module")
def scan(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("scan")
    run(Path(sys.executable).with_name("sawmill"), *SCAN, "--output", "scan.h5", folder=folder)
    return folder / "scan.h5"


def theta(sawmill: Path, scan: Path) -> dict[str, float]:
    constants = ("--data", "counts", "--source-to-cor-mm", "859.46", "--phantom", "l-shape")
    return json.loads(run(sawmill, "calibrate", scan, *constants, "--json", folder=scan.parent))["theta"]


@pytest.mark.nightly
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("version", DECLARED)
def test_the_wheel_gives_the_same_theta_on_each_declared_python(version, wheel, scan, tmp_path):
    python = interpreter(version)
    if python is None:
        pytest.skip(f"there is no Python {version} with ensurepip here")
    run(python, "-m", "venv", tmp_path / "environment", folder=tmp_path)
    programs = tmp_path / "environment/bin"
    pip = (programs / "python", "-m", "pip", "--disable-pip-version-check", "install", "--quiet")
    run(*pip, "--constraint", ROOT / "constraints.txt", wheel, folder=tmp_path)
    # Kernels that are compiled in another order may differ in the last digit.
    run(programs / "sawmill", "compile", folder=tmp_path)
    assert theta(programs / "sawmill", scan) == theta(Path(sys.executable).with_name("sawmill"), scan)
