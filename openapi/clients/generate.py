"""Build the wheel of the Python client from the contract: `generate.py FOLDER`."""

import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent


def build_wheel(folder: Path) -> None:
    """Write the wheel into a folder; raise CalledProcessError where the generator leaves out a part of the contract."""
    with tempfile.TemporaryDirectory(prefix="client-") as temporary:
        source = Path(temporary, "source")
        options = {
            "path": HERE.parent / "openapi.json",
            "config": HERE / "python.yaml",
            "custom-template-path": HERE / "templates",
            "meta": "uv",  # a pyproject.toml: the template's
            "output-path": source,
        }
        flags = [f"--{name}={value}" for name, value in options.items()]
        python("openapi_python_client", "generate", "--fail-on-warning", *flags)
        python("ruff", "check", "--isolated", "--no-cache", "--quiet", "--fix-only", source)
        python("ruff", "format", "--isolated", "--no-cache", "--quiet", source)
        offline = ("--no-index", "--no-deps", "--no-build-isolation", "--disable-pip-version-check")
        python("pip", "wheel", "--quiet", *offline, "--wheel-dir", folder, source)


def python(module: str, *arguments: str | Path) -> None:
    """Run a module of this environment."""
    subprocess.run([sys.executable, "-m", module, *arguments], check=True)


if __name__ == "__main__":
    build_wheel(Path(sys.argv[1]).resolve())
