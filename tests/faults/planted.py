"""Defects planted by hand, one in each room: each must be found by the tests that are named with it.

    python tests/faults/planted.py [--only FILE ...]

Each defect is planted in a copy of the working tree, in which its tests run; a quarter of an hour for all. The exit
code is 1 unless all are found. They stand in planted.toml.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
COPIED = ("benchmarks", "docs", "examples", "installation", "openapi", "service", "tests", "worker")


class Defect(NamedTuple):
    """A defect: in this file of the product the old text, which occurs once, becomes the new one."""

    file: str
    old: str
    new: str
    tests: str

    def place(self, root: Path) -> Path:
        """Find the one file of this name that has the old text."""
        named = [path for top in ("worker", "service") for path in (root / top).rglob(self.file)]
        (place,) = (path for path in named if path.read_text().count(self.old) == 1)
        return place

    def test_files(self, root: Path) -> list[Path]:
        """Find the files of tests that must fail."""
        return [next((root / "tests").rglob(name)) for name in self.tests.split()]


DEFECTS = [Defect(**each) for each in tomllib.loads(Path(__file__).with_suffix(".toml").read_text())["defect"]]


def tests_pass(copy: Path, tests: Iterable[Path]) -> bool:
    """Run tests in the copy, up to the first that fails."""
    command = [sys.executable, "-m", "pytest", "--numprocesses", "0", "--quiet", "--exitfirst", *map(str, tests)]
    environment = {**os.environ, "PYTHONPATH": f"{copy}/service:{copy}/worker"}
    done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, check=False)
    if done.returncode not in {0, 1}:
        sys.exit(f"the tests did not run: {done.stdout[-2000:]}\n{done.stderr[-2000:]}")
    return done.returncode == 0


def is_found(defect: Defect, copy: Path) -> bool:
    """Plant a defect in the copy, run its tests, and take it out again."""
    place = defect.place(copy)
    sound = place.read_text()
    place.write_text(sound.replace(defect.old, defect.new))
    try:
        return not tests_pass(copy, defect.test_files(copy))
    finally:
        place.write_text(sound)


def main() -> int:
    """Plant the defects one after another; print which are found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    files = [defect.file for defect in DEFECTS]
    parser.add_argument("--only", nargs="+", choices=files, default=files, metavar="FILE", help=", ".join(files))
    only = parser.parse_args().only
    chosen, missed = [defect for defect in DEFECTS if defect.file in only], 0
    with tempfile.TemporaryDirectory(prefix="sawmill-planted-") as folder:
        copy = Path(folder) / "copy"
        for name in COPIED:  # with the times of the files, by which compiled kernels are found to be theirs
            shutil.copytree(ROOT / name, copy / name, symlinks=True)
        for file in ("pyproject.toml", "README.md", "CHANGELOG.md", "constraints.txt", "docker-compose.yml"):
            shutil.copy2(ROOT / file, copy / file)
        if not tests_pass(copy, {path: None for defect in chosen for path in defect.test_files(copy)}):
            sys.exit("a test fails without any defect")
        for defect in chosen:
            found = is_found(defect, copy)
            missed += not found
            print(f"{defect.file:24} {'found' if found else 'NOT FOUND'}", flush=True)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
