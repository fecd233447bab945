"""Trial of the wheel in an empty environment, with files named worker.py and service.py in the folder: the demo runs.

Builds the wheel from the working tree, installs it with the pinned versions into a new environment, and runs
`sawmill demo` in a folder that holds modules of names that other people use. Exit code 1 where anything fails.
"""

import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
STRAY_MODULES = ("worker", "service", "tomography", "contracts", "storage")


def main() -> int:
    """Build, install, run."""
    with tempfile.TemporaryDirectory(prefix="wheel-") as folder:
        base = Path(folder)
        wheels, environment, beside = base / "wheels", base / "environment", base / "beside"
        beside.mkdir()
        pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
        run([*pip, "wheel", "--quiet", "--no-deps", "--wheel-dir", str(wheels), str(ROOT)], base)
        (wheel,) = wheels.glob("*.whl")
        print(f"built {wheel.name}, {wheel.stat().st_size / 1e3:.0f} kB", flush=True)
        venv.create(environment, with_pip=True)
        python = str(environment / "bin" / "python")
        constraints = ["--constraint", str(ROOT / "constraints.txt")]
        run(
            [python, "-m", "pip", "--disable-pip-version-check", "install", "--quiet", *constraints, f"{wheel}[all]"],
            base,
        )
        for name in STRAY_MODULES:
            (beside / f"{name}.py").write_text(f'raise ImportError("a stray {name}.py was imported")\n')
        run([python, "-c", "import sawmill_calibration, sawmill_command.commands, sawmill_command.cli"], beside)
        run([str(environment / "bin" / "sawmill"), "demo", "--output", "demo-output"], beside)
        # Import like a notebook: the folder itself is the first entry of sys.path.
        run([python, "-c", "import sawmill_calibration; print(sorted(sawmill_calibration.__all__))"], beside)
        page = beside / "demo-output" / "index.html"
        print(f"demo ran: {page.name}, {page.stat().st_size / 1e3:.0f} kB")
    return 0


def run(command: list[str], folder: Path) -> None:
    """Run one command; its output is shown, and its failure ends the study."""
    print("$", *command, flush=True)
    done = subprocess.run(command, cwd=folder, check=False)  # noqa: S603 - our own commands
    if done.returncode != 0:
        sys.exit(f"ended with exit code {done.returncode}")


if __name__ == "__main__":
    sys.exit(main())
