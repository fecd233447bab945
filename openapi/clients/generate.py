"""Make the Python client from the contract: `generate.py FOLDER`. What was in the folder goes."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
CONTRACT = HERE.parent / "openapi.json"
PYTHON_CLIENT = HERE / "python"


def generate(folder: Path) -> None:
    """Write the client into a folder; raises CalledProcessError where the generator leaves out any of the contract."""
    shutil.rmtree(folder, ignore_errors=True)
    options = {
        "path": CONTRACT,
        "config": HERE / "python.yaml",
        "custom-template-path": HERE / "templates",
        "meta": "uv",  # a pyproject.toml: the template's
        "output-path": folder,
    }
    flags = [f"--{name}={value}" for name, value in options.items()]
    # It formats with the ruff of this environment, which need not be on the caller's path.
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)))
    command = [sys.executable, "-m", "openapi_python_client", "generate", "--fail-on-warning", *flags]
    subprocess.run(command, env={**os.environ, "PATH": path}, check=True)


if __name__ == "__main__":
    generate(Path(sys.argv[1]) if sys.argv[1:] else PYTHON_CLIENT)
